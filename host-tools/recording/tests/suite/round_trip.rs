//! What is written is what is read, the bytes repeat, and NumPy's own files are read.
//!
//! `data/*.npz` were written by NumPy (`data/make.py`); the values below repeat that script's formulas.

use crate::support::right;
use slipsense_recording::{Episode, Meta, Predictions};
use std::fs;
use std::path::Path;

#[test]
fn numpys_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data");
    for name in ["numpy_savez.npz", "numpy_savez_compressed.npz"] {
        let episode = Episode::read(folder.join(name)).unwrap();
        assert_eq!((episode.frames(), episode.sensors), (2, 1));
        for (frame, scan) in episode.piezo.iter().enumerate() {
            for (i, &count) in scan.counts().iter().enumerate() {
                let (row, col) = (i / 32, i % 32);
                let inside = (5..27).contains(&row) && (5..27).contains(&col);
                let expected = if inside { (97 * row + 31 * col + 7 * frame) % 4096 } else { 0 };
                assert_eq!(usize::from(count), expected, "{name} {frame} {row} {col}");
            }
        }
        for (i, &value) in episode.xl[0].as_flattened().iter().enumerate() {
            assert_eq!(i32::from(value), i as i32 * 311 - 32768);
        }
        assert_eq!(episode.xl_batch(0, 0), &episode.xl[0][..34]);
        assert_eq!(episode.xl_batch(1, 0), &episode.xl[0][34..67]);
        assert_eq!(episode.label, Some(vec![1, 2]));
        assert_eq!(episode.slip_true_mm_s, Some(vec![0.0, 12.5]));
        assert_eq!(episode.slip_fraction, Some(vec![0.1, 1.0]));
        assert_eq!(episode.displacement_mm, Some(vec![-0.5, 0.25]));
        let Meta { xl_lsb_g, xl_rate_hz, frame_rate_hz, other } = &episode.meta;
        assert_eq!((*xl_lsb_g, *xl_rate_hz, *frame_rate_hz), (0.000488, 7921.5, 240.0));
        assert_eq!(other["object"], "Tasse, weiß");
        assert_eq!(other["seed"], 5);
        assert_eq!(other.len(), 2);
    }
}

#[test]
fn episodes() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a.npz"), folder.path().join("b.npz"));
    let episode = Episode::from_bytes(&right().npz(), "x").unwrap();
    episode.write(&a).unwrap();
    episode.write(&b).unwrap();
    assert_eq!(Episode::read(&a).unwrap(), episode);
    assert_eq!(fs::read(&a).unwrap(), fs::read(&b).unwrap(), "the same bytes");

    let bare = Episode {
        xl: vec![vec![]; 2],
        xl_end: vec![0; 6],
        label: None,
        slip_true_mm_s: None,
        slip_fraction: None,
        displacement_mm: None,
        meta: Meta::nominal(0.0005),
        ..episode
    };
    bare.write(&a).unwrap();
    assert_eq!(Episode::read(&a).unwrap(), bare, "no sample, nothing optional, over an old file");
}

#[cfg(unix)]
#[test]
fn a_written_file_is_as_readable_as_any_other() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().unwrap();
    let (ours, plain) = (folder.path().join("ours.npz"), folder.path().join("plain"));
    Episode::from_bytes(&right().npz(), "x").unwrap().write(&ours).unwrap();
    fs::write(&plain, b"").unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode();
    assert_eq!(mode(&ours), mode(&plain));
}

fn predictions() -> Predictions {
    let row = |i: usize| std::array::from_fn(|bin| (i * 16 + bin) as f32 * -0.37);
    Predictions {
        sensors: 3,
        class: vec![0, 2],
        logits: vec![[1, -2, i32::MAX], [i32::MIN, 0, 7]],
        log_odds: vec![i32::MIN, 900],
        may_begin: vec![0, 1],
        slip: vec![1, 0],
        logmel: (0..6).map(row).collect(),
        logmel_std: (6..12).map(row).collect(),
    }
}

#[test]
fn predictions_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("p.npz");
    predictions().write(&path).unwrap();
    assert_eq!(Predictions::read(&path).unwrap(), predictions());

    let short = Predictions { logits: vec![[0; 3]], ..predictions() };
    let error = short.write(&path).unwrap_err().to_string();
    assert_eq!(error, format!("{}: array `logits`: 3 values given for shape [2, 3]", path.display()));
    assert_eq!(Predictions::read(&path).unwrap(), predictions(), "the old file");

    fs::write(&path, right().npz()).unwrap();
    let error = Predictions::read(&path).unwrap_err().to_string();
    assert_eq!(error, format!("{}: array `class` is missing", path.display()));
}

/// Generators fill the struct by hand; what they get wrong is refused as a file would be.
#[test]
fn an_episode_made_by_hand() {
    type Edit = fn(&mut Episode);
    let edits: [(Edit, &str); 10] = [
        (|e| e.sensors = 0, "array `piezo`: holds 0 sensors, must be 1 to 3"),
        (|e| e.sensors = 4, "array `piezo`: holds 4 sensors, must be 1 to 3"),
        (|e| e.piezo.clear(), "array `piezo`: holds no frame, must hold at least one"),
        (|e| e.piezo.truncate(5), "array `piezo`: 5 scans are not a multiple of 2 sensors"),
        (|e| e.xl.truncate(1), "array `xl`: holds 1 sensors, must be 2"),
        (|e| e.xl[1].truncate(99), "array `xl`: sensor 1 has 99 samples, must be 100 as sensor 0"),
        (|e| e.xl_end.truncate(5), "array `xl_end`: holds 5 values, must be 6 for 3 frames"),
        (|e| e.label = Some(vec![0]), "array `label`: holds 1 values, must be 3 for 3 frames"),
        (|e| e.slip_true_mm_s = Some(vec![]), "array `slip_true`: holds 0 values, must be 3 for 3 frames"),
        (
            |e| drop(e.meta.other.insert("xl_lsb_g".into(), 1.into())),
            "`meta` key `xl_lsb_g` must not stand among the other keys",
        ),
    ];
    for (edit, rule) in edits {
        let mut wrong = Episode::from_bytes(&right().npz(), "x").unwrap();
        edit(&mut wrong);
        assert_eq!(wrong.validate().unwrap_err().to_string(), rule);
    }
}

/// Episodes composed from recordings whose licences keep them out of this repository.
#[test]
fn real_episodes_where_they_are_at_hand() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/real");
    for (name, frames) in [("slip_up.npz", 2160), ("slip_down.npz", 1440), ("no_slippage.npz", 2160)] {
        let path = folder.join(name);
        if !path.exists() {
            println!("skipped: no {}", path.display());
            continue;
        }
        let start = std::time::Instant::now();
        let episode = Episode::read(&path).unwrap();
        println!("{name}: {frames} frames read in {:?}", start.elapsed());
        assert_eq!((episode.frames(), episode.sensors), (frames, 2));
    }
}
