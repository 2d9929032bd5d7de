//! The model file: written, read back by the microcontroller's own parser, and only then kept.

use anyhow::{Result, anyhow, ensure};
use slipsense::net::Model;
use slipsense_recording::model_file::ModelFile;

/// Bytes that [`Model::parse`] accepts and whose content is what was meant.
pub fn to_bytes(file: &ModelFile) -> Result<Vec<u8>> {
    let bytes = file.to_bytes().map_err(|e| anyhow!("{e}"))?;
    Model::parse(&bytes).map_err(|e| anyhow!("the library refuses the new model: {e}"))?;
    let read = ModelFile::from_bytes(&bytes).map_err(|e| anyhow!("the new model cannot be read: {e}"))?;
    ensure!(read == *file, "the new model was read back differently");
    Ok(bytes)
}
