//! The model file: written, read back by the microcontroller's own parser, and only then kept.

use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use slipsense::net::Model;
use slipsense_model_file::ModelFile;

/// Bytes that [`Model::parse`] accepts and whose content is what was meant.
pub fn to_bytes(file: &ModelFile) -> Result<Vec<u8>> {
    let bytes = file.to_bytes().map_err(|e| anyhow!("{e}"))?;
    let model = Model::parse(&bytes).map_err(|e| anyhow!("the library refuses the new model: {e}"))?;
    ensure!(model.dims == *file.dims(), "the new model was read back with other dimensions");
    let read: Vec<i32> = model.head.weights.iter().map(|&w| i32::from(w as i8)).collect();
    ensure!(read == file.tensor("head", "weight"), "head weight was read back differently");
    let read: Vec<i32> = model.temporal.norm.beta.iter().collect();
    ensure!(read == file.tensor("temporal.norm", "beta"), "temporal.norm beta was read back differently");
    Ok(bytes)
}

/// Write a checked model file.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    crate::output::write(path, bytes).context("the model was not written")
}
