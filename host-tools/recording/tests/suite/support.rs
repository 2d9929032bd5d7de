//! Archives made byte by byte, without the crate's own writer, so that every rule can be broken.

use slipsense_recording::{Episode, EpisodeError};
use std::io::{Cursor, Write};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

pub const FRAMES: usize = 3;
pub const SENSORS: usize = 2;
pub const SAMPLES: usize = 100;
pub const META: &str = r#"{"xl_lsb_g": 0.00049, "xl_rate_hz": 8120, "frame_rate_hz": 240, "object": "mug"}"#;

/// Why an episode is refused, in one line.
pub fn refusal_of(read: Result<Episode, EpisodeError>) -> String {
    let message = read.expect_err("must be refused").to_string();
    assert!(!message.contains('\n'), "one line: {message}");
    message
}

#[derive(Clone)]
pub struct Npy {
    pub name: &'static str,
    pub descr: &'static str,
    pub fortran_order: &'static str,
    pub shape: String,
    pub data: Vec<u8>,
}

impl Npy {
    pub fn new(name: &'static str, descr: &'static str, shape: &[usize], data: Vec<u8>) -> Self {
        let shape = shape.iter().map(|n| format!("{n}, ")).collect::<String>();
        Self { name, descr, fortran_order: "False", shape: format!("({shape})"), data }
    }

    pub fn bytes(&self) -> Vec<u8> {
        let Self { descr, fortran_order, shape, .. } = self;
        let text = format!("{{'descr': '{descr}', 'fortran_order': {fortran_order}, 'shape': {shape}, }}");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((text.len() as u16).to_le_bytes());
        bytes.extend(text.bytes());
        bytes.extend(&self.data);
        bytes
    }
}

/// The arrays of a small right episode: every count 5 in one active taxel, samples 0, 1, 2, ….
#[derive(Clone)]
pub struct Arrays(pub Vec<Npy>);

pub fn right() -> Arrays {
    let mut counts = vec![0u16; FRAMES * SENSORS * 1024];
    for (i, scan) in counts.chunks_mut(1024).enumerate() {
        scan[16 * 32 + 16] = 5 + i as u16;
    }
    let counts = counts.into_iter().flat_map(u16::to_le_bytes).collect();
    let samples = (0..SENSORS * SAMPLES * 3).flat_map(|i| (i as i16).to_le_bytes()).collect();
    let ends = [33u32, 34, 66, 66, 100, 99].into_iter().flat_map(u32::to_le_bytes).collect();
    Arrays(vec![
        Npy::new("piezo", "<u2", &[FRAMES, SENSORS, 32, 32], counts),
        Npy::new("xl", "<i2", &[SENSORS, SAMPLES, 3], samples),
        Npy::new("xl_end", "<u4", &[FRAMES, SENSORS], ends),
        Npy::new("label", "|u1", &[FRAMES], vec![0, 1, 2]),
        floats("slip_true", &[0.0, 0.5, 9.0]),
        floats("slip_fraction", &[0.0, 0.5, 1.0]),
        floats("displacement_mm", &[-1.0, 0.0, 2.5]),
        Npy::new("meta", "|u1", &[META.len()], META.into()),
    ])
}

pub fn floats(name: &'static str, values: &[f32]) -> Npy {
    let data = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    Npy::new(name, "<f4", &[values.len()], data)
}

pub fn meta(json: &str) -> Npy {
    Npy::new("meta", "|u1", &[json.len()], json.into())
}

impl Arrays {
    pub fn at(&mut self, name: &str) -> &mut Npy {
        self.0.iter_mut().find(|npy| npy.name == name).unwrap()
    }

    pub fn without(mut self, name: &str) -> Self {
        self.0.retain(|npy| npy.name != name);
        self
    }

    pub fn with(self, npy: Npy) -> Self {
        let mut arrays = self.without(npy.name);
        arrays.0.push(npy);
        arrays
    }

    pub fn edit(mut self, name: &str, edit: impl FnOnce(&mut Npy)) -> Self {
        edit(self.at(name));
        self
    }

    /// Overwrite one element, given by its number in C order.
    pub fn put<const N: usize>(self, name: &str, element: usize, value: [u8; N]) -> Self {
        self.edit(name, |npy| npy.data[element * N..][..N].copy_from_slice(&value))
    }

    pub fn npz(&self) -> Vec<u8> {
        self.npz_as(CompressionMethod::Deflated)
    }

    pub fn npz_as(&self, method: CompressionMethod) -> Vec<u8> {
        let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
        for npy in &self.0 {
            let options = SimpleFileOptions::default().compression_method(method);
            zip.start_file(format!("{}.npy", npy.name), options).unwrap();
            zip.write_all(&npy.bytes()).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }
}
