//! Test sets that do not change: recipes and content hashes, committed and compiled in.

use serde::{Deserialize, Serialize};

use super::set::{EpisodeSet, PlannedEpisode, check, parse, to_text};
use super::split::{SetError, Split};
use crate::recipe::Recipe;

pub const FROZEN_SEED: u64 = 0;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrozenEpisode {
    pub name: String,
    pub frames: usize,
    pub hash: String,
    pub recipe: Recipe,
}

/// A frozen set, as in `host-tools/synth/frozen/SPLIT.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FrozenSet {
    pub format: u32,
    /// [`GENERATOR_VERSION`](super::GENERATOR_VERSION) that made it.
    pub generator: u32,
    pub split: Split,
    pub seed: u64,
    pub frames: usize,
    /// Slip events by the episodes' labels.
    pub slip_events: usize,
    /// The episodes in order. Last, so that the text can have a line for each.
    pub episodes: Vec<FrozenEpisode>,
}

impl FrozenSet {
    /// Freeze a set: its episodes' hashes, in order, and the number of slip events in all of them.
    ///
    /// # Panics
    /// Where there is not one hash for each episode.
    pub fn new(set: EpisodeSet, hashes: Vec<String>, slip_events: usize) -> Self {
        assert_eq!(set.episodes.len(), hashes.len(), "a hash for each episode");
        let EpisodeSet { format, generator, split, seed, frames, episodes } = set;
        let episodes = episodes
            .into_iter()
            .zip(hashes)
            .map(|(e, hash)| FrozenEpisode { name: e.name, frames: e.frames, hash, recipe: e.recipe })
            .collect();
        Self { format, generator, split, seed, frames, slip_events, episodes }
    }

    /// Read the text of [`FrozenSet::to_text`]; the error names field and rule.
    pub fn parse(text: &str) -> Result<Self, SetError> {
        let frozen: Self = parse(text)?;
        check(frozen.format, frozen.split, frozen.episodes.iter().map(|episode| episode.name.as_str()))?;
        let is_hash = |hash: &str| hash.len() == 64 && hash.bytes().all(|b| b.is_ascii_hexdigit());
        if let Some(episode) = frozen.episodes.iter().find(|episode| !is_hash(&episode.hash)) {
            return Err(SetError::new(format!("`hash` of {} must be 64 hexadecimal digits", episode.name)));
        }
        let sum: usize = frozen.episodes.iter().map(|episode| episode.frames).sum();
        if sum != frozen.frames {
            return Err(SetError::new(format!("`frames` is {}, its episodes have {sum}", frozen.frames)));
        }
        Ok(frozen)
    }

    /// JSON with one line for each episode.
    pub fn to_text(&self) -> String {
        to_text(&Self { episodes: Vec::new(), ..self.clone() }, &self.episodes)
    }

    /// The set without its hashes.
    pub fn set(&self) -> EpisodeSet {
        let planned = |e: FrozenEpisode| PlannedEpisode { name: e.name, frames: e.frames, recipe: e.recipe };
        EpisodeSet {
            format: self.format,
            generator: self.generator,
            split: self.split,
            seed: self.seed,
            frames: self.frames,
            episodes: self.episodes.iter().cloned().map(planned).collect(),
        }
    }
}

impl Split {
    /// The split's frozen set, compiled in; `train` has none. The error names the damaged manifest.
    pub fn frozen(self) -> Result<FrozenSet, SetError> {
        let text = self.manifest();
        let text = text.ok_or_else(|| SetError::new(format!("{self}: no set of this split is frozen")))?;
        let manifest = |rule: String| SetError::new(format!("host-tools/synth/frozen/{self}.json: {rule}"));
        let frozen = FrozenSet::parse(text).map_err(|error| manifest(error.to_string()))?;
        if frozen.split != self {
            return Err(manifest(format!("`split` is {}", frozen.split)));
        }
        Ok(frozen)
    }
}
