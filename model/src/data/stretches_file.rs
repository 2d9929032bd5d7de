//! Features of stretches as a safetensors file, one group of tensors a stretch.

use anyhow::{Context, Result, ensure};
use safetensors::{Dtype, SafeTensors};
use slipsense::params::{CLASSES, MEL_BINS, TAXELS, XL_FEATURES};

use super::{Features, Reading};
use crate::target::Target;
use crate::tensors_file::{self, Entry, bytes_of};

/// Tensors of a stretch: name, type, numbers in a row.
const TENSORS: [(&str, Dtype, usize); 7] = [
    ("piezo", Dtype::U16, TAXELS),
    ("touched", Dtype::U8, 1),
    ("ln_power", Dtype::F32, MEL_BINS),
    ("floor", Dtype::F32, MEL_BINS),
    ("xl", Dtype::I16, XL_FEATURES),
    ("label", Dtype::U8, 1),
    ("target", Dtype::U8, 1),
];
const TARGETS: [Target; 4] = [Target::Still, Target::Slides, Target::Begins, Target::Either];

/// The bytes of a file of these stretches. Counts are of the touched scans only.
pub fn to_bytes(stretches: &[Features]) -> Result<Vec<u8>> {
    let mut all: Vec<Entry> = Vec::new();
    for (index, stretch) in stretches.iter().enumerate() {
        let readings = || stretch.readings.iter();
        let scans = readings().filter_map(|reading| reading.scan.as_deref());
        let bytes: [Vec<u8>; TENSORS.len()] = [
            scans.flatten().flat_map(|x| x.to_le_bytes()).collect(),
            readings().map(|reading| reading.scan.is_some().into()).collect(),
            readings().flat_map(|reading| bytes_of(&reading.ln_power)).collect(),
            readings().flat_map(|reading| bytes_of(&reading.floor)).collect(),
            readings().flat_map(|reading| reading.xl).flat_map(i16::to_le_bytes).collect(),
            stretch.label.clone(),
            stretch.target.iter().map(|&target| target as u8).collect(),
        ];
        all.extend(TENSORS.into_iter().zip(bytes).map(|((name, dtype, row), bytes)| {
            let shape = vec![bytes.len() * 8 / dtype.bitsize() / row, row];
            (format!("{index}.{name}"), dtype, shape, bytes)
        }));
    }
    tensors_file::to_bytes(all, None)
}

/// The stretches of a file, as mined; refuses what does not fit together by name.
pub fn from_bytes(bytes: &[u8]) -> Result<Vec<Features>> {
    let file = SafeTensors::deserialize(bytes).context("not a safetensors file")?;
    (0..file.len() / TENSORS.len()).map(|index| stretch(&file, index)).collect()
}

fn stretch(file: &SafeTensors<'_>, index: usize) -> Result<Features> {
    let mut tensors = Vec::new();
    for (name, dtype, row) in TENSORS {
        let name = format!("{index}.{name}");
        let view = file.tensor(&name).with_context(|| format!("tensor {name} is missing"))?;
        ensure!(view.dtype() == dtype, "tensor {name} is {:?}, must be {dtype:?}", view.dtype());
        let shape = view.shape();
        ensure!(shape.get(1..) == Some(&[row]), "tensor {name}: shape {shape:?} is not [N, {row}]");
        tensors.push((shape[0], view.data().to_vec()));
    }
    let real = |(_, bytes): &(usize, Vec<u8>)| -> Vec<[f32; MEL_BINS]> {
        let all: Vec<f32> = bytes.as_chunks().0.iter().map(|&x| f32::from_le_bytes(x)).collect();
        all.as_chunks().0.to_vec()
    };
    let [(scans, piezo), (rows, touched), ln_power, floor, (_, xl), (frames, label), (_, target)] =
        tensors.try_into().ok().context("tensors")?;
    let piezo: Vec<u16> = piezo.as_chunks().0.iter().map(|&x| u16::from_le_bytes(x)).collect();
    let xl: Vec<i16> = xl.as_chunks().0.iter().map(|&x| i16::from_le_bytes(x)).collect();
    let (ln_power, floor, xl) = (real(&ln_power), real(&floor), xl.as_chunks().0);
    let target: Vec<Target> =
        target.iter().filter_map(|&target| TARGETS.get(usize::from(target)).copied()).collect();
    let sensors = rows / frames.max(1);
    let rows_fit = [ln_power.len(), floor.len(), xl.len(), sensors * frames];
    ensure!(frames > 0 && rows_fit == [rows; 4], "stretch {index}: its tensors are of different lengths");
    ensure!(target.len() == frames, "stretch {index}: tensor target must be 0 to 3, a frame each");
    ensure!(label.iter().all(|&x| usize::from(x) < CLASSES), "stretch {index}: tensor label must be 0 to 2");
    let touches = touched.iter().filter(|&&touched| touched != 0).count();
    ensure!(touches == scans, "stretch {index}: {scans} scans of {touches} touches");
    let mut scans = piezo.as_chunks().0.iter().map(|&counts| Box::new(counts));
    let reading = |row: usize| Reading {
        scan: if touched[row] != 0 { scans.next() } else { None },
        ln_power: ln_power[row],
        floor: floor[row],
        xl: xl[row],
    };
    Ok(Features { sensors, readings: (0..rows).map(reading).collect(), label, target, mined: true })
}
