//! What an episode holds, as one number, and the hashes of a whole set, as in `hashes.json`: over the decoded
//! arrays, not over the bytes of a file, so that another compressor changes nothing.

use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use slipsense_recording::{Episode, hex};

use super::set::{EpisodeSet, FORMAT, check, parse, to_text};
use super::split::{SetError, Split};
use crate::recipe::Recipe;

/// SHA-256 of an episode's content, 64 hexadecimal digits.
///
/// Hashed are, each after its name and its length in bytes (u64, little-endian): `piezo` (u16), `xl`
/// (i16), `xl_end` (u32), `label` (u8), `slip_true`, `slip_fraction`, `displacement_mm` (f32), all
/// little-endian in the order of the file, `xl_lsb_g` (f32) and `recipe` (JSON in the order of [`Recipe`]'s
/// fields). What is absent is hashed as empty.
pub fn content_hash(episode: &Episode) -> String {
    let mut hash = Sha256::new();
    let mut array = |name: &str, bytes: Vec<u8>| {
        hash.update(name);
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(&bytes);
    };
    let counts = episode.piezo.iter().flat_map(|scan| scan.counts());
    array("piezo", counts.flat_map(|count| count.to_le_bytes()).collect());
    array("xl", episode.xl.iter().flatten().flatten().flat_map(|s| s.to_le_bytes()).collect());
    array("xl_end", episode.xl_end.iter().flat_map(|end| end.to_le_bytes()).collect());
    array("label", episode.label.iter().flatten().copied().collect());
    for (name, values) in [
        ("slip_true", &episode.slip_true_mm_s),
        ("slip_fraction", &episode.slip_fraction),
        ("displacement_mm", &episode.displacement_mm),
    ] {
        array(name, values.iter().flatten().flat_map(|v| v.to_le_bytes()).collect());
    }
    array("xl_lsb_g", (episode.meta.xl_lsb_g as f32).to_le_bytes().to_vec());
    // Through the type, because the order of keys in a JSON map is not the file's business.
    let recipe = recipe_of(episode).and_then(|recipe| serde_json::to_vec(&recipe).ok());
    array("recipe", recipe.unwrap_or_default());
    hex(&hash.finalize())
}

/// SHA-256 over the content hashes of a set in order, 64 hexadecimal digits: one number to compare.
pub fn set_hash<'a>(hashes: impl IntoIterator<Item = &'a str>) -> String {
    let mut hash = Sha256::new();
    for one in hashes {
        hash.update(one);
        hash.update("\n");
    }
    hex(&hash.finalize())
}

/// The recipe that an episode's metadata carries, if one does.
pub fn recipe_of(episode: &Episode) -> Option<Recipe> {
    episode.meta.other.get("recipe").and_then(|recipe| serde_json::from_value(recipe.clone()).ok())
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeHash {
    pub name: String,
    pub hash: String,
}

#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetHashes {
    pub format: u32,
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
