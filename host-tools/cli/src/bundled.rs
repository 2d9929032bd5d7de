//! What the binary carries, so that it runs anywhere: the trained model and the demo's episode.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::net::{Aligned, Model};
use slipsense_recording::Episode;

/// The model that is used where none is named. Its card lies beside it.
pub const MODEL: &[u8] = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;

/// The float weights that it was made from.
#[cfg(feature = "train")]
pub const WEIGHTS: &[u8] = include_bytes!("../../../model/weights/slipsense.safetensors");

/// The demo's episode, synthetic, made from `demo/recipe.json`.
pub const EPISODE: &[u8] = include_bytes!("../demo/episode.npz");

/// What the bundled files are called where a path would stand.
pub const NAME: &str = "bundled";

/// A model file's bytes, and its name for errors and results.
pub struct NamedModel {
    pub bytes: Vec<u8>,
    /// The path, or `bundled`.
    pub name: String,
}

/// The model at `path`, the bundled one if there is none.
pub fn model(path: Option<&Path>) -> Result<NamedModel> {
    let Some(path) = path else { return Ok(NamedModel { bytes: MODEL.to_vec(), name: NAME.to_owned() }) };
    let name = path.display().to_string();
    let bytes = std::fs::read(path).with_context(|| format!("{name}: cannot read the model"))?;
    Ok(NamedModel { bytes, name })
}

impl NamedModel {
    pub fn parse(&self) -> Result<Model<'_>> {
        Model::parse(&self.bytes).with_context(|| format!("model {}", self.name))
    }
}

pub fn episode() -> Result<Episode> {
    Ok(Episode::from_bytes(EPISODE, NAME)?)
}
