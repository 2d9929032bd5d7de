//! What the binary carries, so that it runs anywhere: the trained model and the demo's episode.

/// The model that is used where none is named. Its card lies beside it.
pub const MODEL: &[u8] = include_bytes!("../../../model/weights/slipsense.slipnet");

/// The demo's episode, synthetic, made from `demo/recipe.json`.
pub const EPISODE: &[u8] = include_bytes!("../demo/episode.npz");

/// What the bundled files are called where a path would stand.
pub const NAME: &str = "bundled";
