//! The content hashes of a whole set, as in `hashes.json`.

use serde::{Deserialize, Serialize};

use super::set::{check, parse, to_text};
use super::{EpisodeSet, FORMAT, SetError, Split, set_hash};

/// Content hash of one episode.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeHash {
    /// As in [`PlannedEpisode`](super::PlannedEpisode).
    pub name: String,
    /// [`content_hash`](super::content_hash) of the episode.
    pub hash: String,
}

/// Content hashes of a set.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetHashes {
    /// [`FORMAT`].
    pub format: u32,
    /// Split.
    pub split: Split,
    /// [`set_hash`] of them all: one number to compare.
    pub set: String,
    /// In the order of the set. Last, so that the text can have a line for each.
    pub episodes: Vec<EpisodeHash>,
}

impl SetHashes {
    /// The hashes of a set's episodes, in order.
    ///
    /// # Panics
    /// Where there is not one hash for each episode.
    pub fn new(set: &EpisodeSet, hashes: Vec<String>) -> Self {
        assert_eq!(set.episodes.len(), hashes.len(), "a hash for each episode");
        let names = set.episodes.iter().map(|episode| episode.name.clone());
        let episodes: Vec<_> = names.zip(hashes).map(|(name, hash)| EpisodeHash { name, hash }).collect();
        let all = set_hash(episodes.iter().map(|episode| episode.hash.as_str()));
        Self { format: FORMAT, split: set.split, set: all, episodes }
    }

    /// Read the text of [`SetHashes::to_text`] for a set; the error names field and rule.
    pub fn parse(text: &str, set: &EpisodeSet) -> Result<Self, SetError> {
        let hashes: Self = parse(text)?;
        if hashes.split != set.split {
            return Err(SetError::new(format!("`split` is {}, the set's is {}", hashes.split, set.split)));
        }
        check(hashes.format, hashes.split, hashes.episodes.iter().map(|episode| episode.name.as_str()))?;
        let (found, must) = (hashes.episodes.len(), set.episodes.len());
        if found != must {
            return Err(SetError::new(format!("`episodes` has {found} entries, the set has {must}")));
        }
        if hashes.set != set_hash(hashes.episodes.iter().map(|episode| episode.hash.as_str())) {
            return Err(SetError::new("`set` is not the hash of the hashes below it"));
        }
        Ok(hashes)
    }

    /// JSON with one line for each episode.
    pub fn to_text(&self) -> String {
        to_text(&Self { episodes: Vec::new(), ..self.clone() }, &self.episodes)
    }
}
