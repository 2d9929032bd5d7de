//! Bytes made wrong.

use rand::Rng;
use rand_chacha::ChaCha8Rng;

/// Bytes of random input, at most.
const RANDOM_MAX: usize = 2_000;
/// Changes of one input, at most.
const CHANGES_MAX: u32 = 5;
/// Numbers at the edges of what a length, a count or an index may be.
const EDGES: [u64; 12] =
    [0, 1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 1 << 32, 1 << 40, i64::MAX as u64, u64::MAX];

/// One of the corpus as it is, or random, or with a few changes.
pub fn mutate(corpus: &[Vec<u8>], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = corpus[rng.random_range(0..corpus.len())].clone();
    match rng.random_range(0..32) {
        0 => {}
        1 => bytes = (0..rng.random_range(0..RANDOM_MAX)).map(|_| rng.random()).collect(),
        2 => bytes.resize(bytes.len() + rng.random_range(0..64), 0),
        _ => {
            for _ in 0..rng.random_range(1..=CHANGES_MAX) {
                change(&mut bytes, corpus, rng);
            }
        }
    }
    bytes
}

fn change(bytes: &mut Vec<u8>, corpus: &[Vec<u8>], rng: &mut ChaCha8Rng) {
    if bytes.is_empty() {
        return;
    }
    let at = rng.random_range(0..bytes.len());
    let length = rng.random_range(0..=(bytes.len() - at).min(64));
    match rng.random_range(0..10) {
        0 => bytes.truncate(at),
        1 => _ = bytes.drain(at..at + length),
        2 => {
            let again = bytes[at..at + length].to_vec();
            drop(bytes.splice(at..at, again));
        }
        3 => {
            // The end of another, from anywhere.
            let other = &corpus[rng.random_range(0..corpus.len())];
            let from = if rng.random() { at.min(other.len()) } else { rng.random_range(0..=other.len()) };
            bytes.truncate(at);
            bytes.extend_from_slice(&other[from..]);
        }
        4 | 5 => {
            let edge = EDGES[rng.random_range(0..EDGES.len())].to_le_bytes();
            let width = [1, 2, 4, 8][rng.random_range(0..4)];
            bytes.iter_mut().skip(at).zip(&edge[..width]).for_each(|(byte, &edge)| *byte = edge);
        }
        6 => bytes[at] = rng.random(),
        7 => bytes[at] = bytes[at].wrapping_add(if rng.random() { 1 } else { u8::MAX }),
        _ => bytes[at] ^= 1 << rng.random_range(0..8),
    }
}
