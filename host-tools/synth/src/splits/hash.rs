//! What an episode holds, as one number: over the decoded arrays, not over the bytes of its file, so
//! that another compressor changes nothing.

use sha2::{Digest, Sha256};
use slipsense_recording::Episode;

use crate::recipe::Recipe;

/// SHA-256 of an episode's content, 64 hexadecimal digits.
///
/// Hashed are, each after its name and its length in bytes (u64, little-endian): `piezo` (u16), `xl`
/// (i16), `xl_end` (u32), `label` (u8), `slip_true`, `slip_fraction`, `displacement_mm` (f32), all
/// little-endian in the order of the file, `xl_lsb_g` (f32) and `recipe` (JSON in the order of [`Recipe`]'s
/// fields). What is absent is hashed as empty.
pub fn content_hash(episode: &Episode) -> String {
    let mut hash = Sha256::new();
    let mut bytes = Vec::new();
    let mut array = |name: &str, bytes: &mut Vec<u8>| {
        hash.update(name);
        hash.update((bytes.len() as u64).to_le_bytes());
        hash.update(&bytes);
        bytes.clear();
    };
    bytes.extend(episode.piezo.iter().flat_map(|scan| scan.counts()).flat_map(|c| c.to_le_bytes()));
    array("piezo", &mut bytes);
    bytes.extend(episode.xl.iter().flatten().flatten().flat_map(|s| s.to_le_bytes()));
    array("xl", &mut bytes);
    bytes.extend(episode.xl_end.iter().flat_map(|end| end.to_le_bytes()));
    array("xl_end", &mut bytes);
    bytes.extend(episode.label.iter().flatten());
    array("label", &mut bytes);
    for (name, values) in [
        ("slip_true", &episode.slip_true_mm_s),
        ("slip_fraction", &episode.slip_fraction),
        ("displacement_mm", &episode.displacement_mm),
    ] {
        bytes.extend(values.iter().flatten().flat_map(|v| v.to_le_bytes()));
        array(name, &mut bytes);
    }
    bytes.extend((episode.meta.xl_lsb_g as f32).to_le_bytes());
    array("xl_lsb_g", &mut bytes);
    // Through the type, because the order of keys in a JSON map is not the file's business.
    if let Some(recipe) = recipe_of(episode) {
        bytes.extend(serde_json::to_string(&recipe).unwrap_or_default().bytes());
    }
    array("recipe", &mut bytes);
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

fn hex(digest: &[u8]) -> String {
    use std::fmt::Write;
    digest.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}
