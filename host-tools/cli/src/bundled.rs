//! What the binary carries, so that it runs anywhere: the trained model and the demo's episode.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::net::Aligned;

/// The model that is used where none is named. Its card lies beside it.
pub const MODEL: &[u8] = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;

/// The float weights that it was made from.
#[cfg(feature = "train")]
pub const WEIGHTS: &[u8] = include_bytes!("../../../model/weights/slipsense.safetensors");

/// The demo's episode, synthetic, made from `demo/recipe.json`.
pub const EPISODE: &[u8] = include_bytes!("../demo/episode.npz");

/// What the bundled files are called where a path would stand.
pub const NAME: &str = "bundled";

/// Bytes and name of the model at `path`, of the bundled one if there is none.
pub(crate) fn model_or(path: Option<&Path>) -> Result<(Vec<u8>, String)> {
    match path {
        Some(path) => {
            let bytes =
                std::fs::read(path).with_context(|| format!("{}: cannot read the model", path.display()))?;
            Ok((bytes, path.display().to_string()))
        }
        None => Ok((MODEL.to_vec(), NAME.to_owned())),
    }
}
