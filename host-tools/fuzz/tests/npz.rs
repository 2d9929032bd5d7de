//! Episode files: read or refused in one line that names the file, whatever they hold.

use std::io::{Cursor, Read, Write};

use rand::Rng;
use rand_chacha::ChaCha8Rng;
use slipsense::params::TAXELS;
use slipsense::sensor::PiezoFrame;
use slipsense_fuzz::{corpus, mutate, run};
use slipsense_recording::{Episode, Meta};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

const CORPUS: &str = "host-tools/fuzz/corpus/npz";

fn is_read(bytes: &[u8]) -> bool {
    match Episode::from_bytes(bytes, "grasp.npz") {
        Ok(_) => true,
        Err(error) => {
            let error = error.to_string();
            assert!(error.starts_with("grasp.npz") && !error.contains('\n'), "{error:?}");
            false
        }
    }
}

/// Changes anywhere: in the directory, in deflated bytes, of which the checksum is wrong afterwards.
#[test]
fn npz() {
    let corpus = corpus(CORPUS);
    let ran = run("npz", |rng| mutate(&corpus, rng), is_read);
    assert!(ran.accepted * 100 > ran.inputs, "almost nothing gets through: {ran:?}");
}

/// Changes of an array, header or data, in an archive that is right about it.
#[test]
fn npz_arrays() {
    let files: Vec<Vec<(String, Vec<u8>)>> = corpus(CORPUS).iter().map(|bytes| arrays(bytes)).collect();
    let headers: Vec<Vec<u8>> = files.iter().flatten().map(|(_, bytes)| bytes[..128].to_vec()).collect();
    let make = |rng: &mut ChaCha8Rng| {
        let mut arrays = files[rng.random_range(0..files.len())].clone();
        let count = arrays.len();
        let (_, bytes) = &mut arrays[rng.random_range(0..count)];
        if rng.random() {
            *bytes = mutate(std::slice::from_ref(bytes), rng);
        } else {
            // Of thousands of bytes the first say what the others are.
            let header = bytes[..128].to_vec();
            let mut changed = mutate(&[&[header][..], &headers[..]].concat(), rng);
            changed.extend_from_slice(&bytes[128..]);
            *bytes = changed;
        }
        archive(&arrays)
    };
    let ran = run("npz-arrays", make, is_read);
    assert!(ran.accepted * 100 > ran.inputs, "almost nothing gets through: {ran:?}");
}

fn arrays(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = ZipArchive::new(Cursor::new(bytes)).unwrap();
    (0..zip.len())
        .map(|index| {
            let mut entry = zip.by_index(index).unwrap();
            let (name, mut bytes) = (entry.name().unwrap().into_owned(), Vec::new());
            entry.read_to_end(&mut bytes).unwrap();
            (name, bytes)
        })
        .collect()
}

fn archive(arrays: &[(String, Vec<u8>)]) -> Vec<u8> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    for (name, bytes) in arrays {
        zip.start_file(name.as_str(), stored).unwrap();
        zip.write_all(bytes).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[test]
fn the_corpus_is_read() {
    assert!(corpus(CORPUS).iter().all(|bytes| is_read(bytes)));
}

#[test]
#[ignore = "writes files"]
fn write_corpus() {
    let folder = format!("{}/../../{CORPUS}", env!("CARGO_MANIFEST_DIR"));
    std::fs::create_dir_all(&folder).unwrap();
    let scan =
        |k: usize| PiezoFrame::from_scan(std::array::from_fn::<u16, TAXELS, _>(|i| (i * k % 90) as u16));
    let mut episode = Episode {
        sensors: 1,
        piezo: vec![scan(0), scan(3)],
        xl: vec![(0..5).map(|i| [i, -i, 2_000]).collect()],
        xl_end: vec![2, 5],
        label: None,
        slip_true_mm_s: None,
        slip_fraction: None,
        displacement_mm: None,
        meta: Meta::nominal(0.000_5),
    };
    episode.write(format!("{folder}/plain.npz")).unwrap();
    episode.label = Some(vec![1, 2]);
    episode.slip_true_mm_s = Some(vec![0.0, 3.5]);
    episode.slip_fraction = Some(vec![0.0, 1.0]);
    episode.displacement_mm = Some(vec![0.0, 0.1]);
    episode.write(format!("{folder}/labelled.npz")).unwrap();
}
