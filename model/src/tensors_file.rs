//! Safetensors files: numbers to bytes and back.

use std::collections::HashMap;

use anyhow::{Result, bail, ensure};
use safetensors::Dtype;
use safetensors::tensor::TensorView;

/// A tensor of a file: name, type, shape, little-endian bytes.
pub(crate) type Entry = (String, Dtype, Vec<usize>, Vec<u8>);

pub(crate) fn bytes_of(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|x| x.to_le_bytes()).collect()
}

pub(crate) fn to_bytes(
    tensors: impl IntoIterator<Item = Entry>,
    metadata: Option<HashMap<String, String>>,
) -> Result<Vec<u8>> {
    let tensors: Vec<Entry> = tensors.into_iter().collect();
    let views = tensors
        .iter()
        .map(|(name, dtype, shape, bytes)| Ok((name, TensorView::new(*dtype, shape.clone(), bytes)?)));
    Ok(safetensors::serialize(views.collect::<Result<Vec<_>>>()?, metadata)?)
}

/// The numbers of a tensor; refuses other types than `f32` and what is not finite, by name.
pub(crate) fn finite(name: &str, view: &TensorView<'_>) -> Result<Vec<f32>> {
    ensure!(view.dtype() == Dtype::F32, "tensor {name} is {:?}, must be F32", view.dtype());
    let values: Vec<f32> = view.data().as_chunks().0.iter().map(|&b| f32::from_le_bytes(b)).collect();
    if let Some(index) = values.iter().position(|x| !x.is_finite()) {
        bail!("tensor {name} index {index} is {}: must be finite", values[index]);
    }
    Ok(values)
}
