//! Features of stretches as a safetensors file, one group of tensors a stretch.

use anyhow::{Context, Result, ensure};
use safetensors::{Dtype, SafeTensors};
use slipsense::params::{CLASSES, MEL_BINS, TAXELS, XL_FEATURES};

use super::Features;
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
        let bytes: [Vec<u8>; TENSORS.len()] = [
            stretch.piezo.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect(),
            stretch.touched.iter().map(|&touched| touched.into()).collect(),
            bytes_of(stretch.ln_power.as_flattened()),
            bytes_of(stretch.floor.as_flattened()),
            stretch.xl.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect(),
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
        ensure!(
            view.shape().get(1..) == Some(&[row]),
            "tensor {name}: shape {:?} is not [N, {row}]",
            view.shape()
        );
        tensors.push((view.shape()[0], view.data().to_vec()));
    }
    let real = |(_, bytes): &(usize, Vec<u8>)| -> Vec<[f32; MEL_BINS]> {
        let all: Vec<f32> = bytes.as_chunks().0.iter().map(|&x| f32::from_le_bytes(x)).collect();
        all.as_chunks().0.to_vec()
    };
    let [(scans, piezo), (rows, touched), ln_power, floor, (_, xl), (frames, label), (_, target)] =
        tensors.try_into().ok().context("tensors")?;
    let piezo: Vec<u16> = piezo.as_chunks().0.iter().map(|&x| u16::from_le_bytes(x)).collect();
    let xl: Vec<i16> = xl.as_chunks().0.iter().map(|&x| i16::from_le_bytes(x)).collect();
    let mut next = 0..;
    let found = Features {
        sensors: rows / frames.max(1),
        piezo: piezo.as_chunks().0.to_vec(),
        scan: touched.iter().map(|&touched| (touched != 0).then(|| next.next()).flatten()).collect(),
        ln_power: real(&ln_power),
        floor: real(&floor),
        xl: xl.as_chunks().0.to_vec(),
        touched: touched.iter().map(|&touched| touched != 0).collect(),
        label,
        target: target.iter().filter_map(|&target| TARGETS.get(usize::from(target)).copied()).collect(),
        mined: true,
    };
    let rows_fit = [found.ln_power.len(), found.floor.len(), found.xl.len(), found.sensors * frames];
    ensure!(frames > 0 && rows_fit == [rows; 4], "stretch {index}: its tensors are of different lengths");
    ensure!(found.target.len() == frames, "stretch {index}: tensor target must be 0 to 3, a frame each");
    ensure!(
        found.label.iter().all(|&x| usize::from(x) < CLASSES),
        "stretch {index}: tensor label must be 0 to 2"
    );
    let touches = found.touched.iter().filter(|&&touched| touched).count();
    ensure!(touches == scans, "stretch {index}: {scans} scans of {touches} touches");
    Ok(found)
}
