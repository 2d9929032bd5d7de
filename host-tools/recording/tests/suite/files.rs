//! Damaged archives, the file system's refusals, and what must not be left behind.

use crate::support::{refusal_of, right};
use slipsense_recording::{Episode, Problem};
use std::fs;
use std::path::Path;
use zip::CompressionMethod;

#[test]
fn missing_file_folder_and_what_is_no_archive() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("none.npz");
    let refused = |path: &Path, rule: &str| {
        assert_eq!(refusal_of(Episode::read(path)), format!("{}: {rule}", path.display()));
    };
    refused(&path, "cannot read: No such file or directory (os error 2)");
    refused(folder.path(), "is a folder, must be an .npz file");
    for (bytes, rule) in [
        (&b""[..], "is empty, must be an .npz archive"),
        (b"P", "is not an .npz (zip) archive"),
        (b"frame,count\n0,1\n", "is not an .npz (zip) archive"),
    ] {
        fs::write(&path, bytes).unwrap();
        refused(&path, rule);
    }
}

#[test]
fn truncated_anywhere() {
    let whole = right().npz();
    for length in (2..whole.len()).step_by(7).chain([whole.len() - 1]) {
        let message = refusal_of(Episode::from_bytes(&whole[..length], "cut.npz"));
        let rule = "cut.npz: is a zip archive cut short or damaged: ";
        assert!(message.starts_with(rule), "{length}: {message}");
    }
}

/// A flipped bit is either found or, where it hits a date or an attribute, without effect: never a
/// crash and never other data.
#[test]
fn damaged_anywhere() {
    let whole = right().npz();
    let episode = Episode::from_bytes(&whole, "x").unwrap();
    let mut refused = 0;
    for i in 0..whole.len() {
        let mut damaged = whole.clone();
        damaged[i] ^= 1 << (i % 8);
        match Episode::from_bytes(&damaged, "x") {
            Err(error) => {
                refused += 1;
                assert!(!error.to_string().contains('\n'), "byte {i}: {error}");
            }
            // A changed name of an optional array makes it an unknown one.
            Ok(read) => {
                assert_eq!(
                    (&read.piezo, &read.xl, &read.xl_end),
                    (&episode.piezo, &episode.xl, &episode.xl_end)
                );
                assert_eq!(read.meta, episode.meta, "byte {i}");
            }
        }
    }
    assert!(refused > whole.len() / 2, "{refused} of {}", whole.len());
}

#[test]
fn a_damaged_array_is_named() {
    let mut npz = right().npz_as(CompressionMethod::Stored);
    let count = npz.windows(5).position(|bytes| bytes == [0, 5, 0, 0, 0]).unwrap() + 1;
    npz[count] = 6;
    let damaged = "array `piezo`: data is cut short or damaged: Invalid checksum";
    let mut arrays = right();
    arrays.at("xl").fortran_order = "maybe";
    let wrong = "array `xl`: has a .npy header that is not the dictionary NumPy writes";
    for (bytes, rule) in [(npz, damaged), (arrays.npz(), wrong)] {
        assert_eq!(refusal_of(Episode::from_bytes(&bytes, "x.npz")), format!("x.npz: {rule}"));
    }
}

#[test]
fn sizes_that_the_archive_itself_lies_about_allocate_nothing() {
    // The shape and both size fields of the zip's entry agree on 2 GB, in a file of 2 kB.
    let frames = 976_562;
    let bytes_claimed = frames * 2048;
    let lying = right().edit("piezo", |npy| {
        npy.shape = format!("({frames}, 1, 32, 32)");
    });
    let entry_bytes = lying.0[0].bytes().len() as u32;
    let header_bytes = entry_bytes - lying.0[0].data.len() as u32;
    let mut npz = lying.npz();
    let mut changed = 0;
    for at in 0..npz.len() - 4 {
        if npz[at..at + 4] == entry_bytes.to_le_bytes() {
            npz[at..at + 4].copy_from_slice(&(bytes_claimed + header_bytes).to_le_bytes());
            changed += 1;
        }
    }
    assert_eq!(changed, 2, "local and central directory");
    let message = refusal_of(Episode::from_bytes(&npz, "x"));
    assert!(message.ends_with("more than the file can hold; cut short or damaged"), "{message}");
}

#[test]
fn a_write_that_fails_leaves_nothing_behind() {
    let episode = Episode::from_bytes(&right().npz(), "x").unwrap();
    let folder = tempfile::tempdir().unwrap();

    let absent = folder.path().join("absent").join("out.npz");
    let error = episode.write(&absent).unwrap_err();
    assert!(matches!(error.problem, Problem::Write(_)));
    let shown = absent.display();
    let rule = format!("{shown}: cannot write: No such file or directory");
    assert!(error.to_string().starts_with(&rule), "{error}");

    fs::write(folder.path().join("file"), b"").unwrap();
    fs::create_dir(folder.path().join("taken")).unwrap();
    for (name, rule) in [
        ("file/out.npz", "file/out.npz: cannot write: Not a directory"),
        ("taken", "taken: cannot write: Is a directory"),
        // Where nobody can make a file, root neither.
        ("/proc/out.npz", "/proc/out.npz: cannot write: "),
    ] {
        let error = episode.write(folder.path().join(name)).unwrap_err().to_string();
        assert!(error.contains(rule), "{error}");
    }

    let mut wrong = episode.clone();
    wrong.xl_end[3] = 1;
    let old = folder.path().join("old.npz");
    episode.write(&old).unwrap();
    let before = fs::read(&old).unwrap();
    let error = wrong.write(&old).unwrap_err().to_string();
    assert!(error.ends_with("`xl_end`[1, 1] is 1: must not decrease, the frame before has 34"), "{error}");
    assert_eq!(fs::read(&old).unwrap(), before, "the old file is as it was");

    let entries = fs::read_dir(folder.path()).unwrap();
    let mut left: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    left.sort();
    assert_eq!(left, ["file", "old.npz", "taken"]);
}
