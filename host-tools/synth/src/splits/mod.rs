//! Which episodes make a set: the splits of the benchmark, their sizes, and the test sets that are frozen.
//!
//! A set is named by split, seed and number of frames, and is a list of recipes that follows from these
//! three alone: neither the number of processes that make it nor their order matters. With the same seed
//! a larger set begins with the smaller one.

mod schedule;
mod frozen;
mod hashes;
mod set;
mod split;
#[cfg(test)]
mod tests;

pub use frozen::{FROZEN_SEED, FrozenEpisode, FrozenSet};
pub use hashes::{EpisodeHash, SetHashes, content_hash, recipe_of, set_hash};
pub(crate) use schedule::hashed;
pub use schedule::tuning_disturbances;
pub use set::{EpisodeSet, FORMAT, PlannedEpisode, paper_set};
pub use split::{GENERATOR_VERSION, PAPER_FRAMES, SetError, Split};
