//! Generator of labelled synthetic episodes.
//!
//! A [`Recipe`] names a seed and what may be left to it; [`generate`] makes the episode: scenario →
//! contact and partial slip → taxel film and finger vibration → counts and samples → labels. What it
//! makes is synthetic, says so in its metadata, and carries no claim about a real gripper.
//!
//! The same recipe gives the same episode to the bit. It is meant to do so on every platform, though it
//! has been checked on x86-64 Linux only: the draws are ChaCha's, and sines and powers come from the
//! `libm` crate, because the standard library's differ in their last bit from platform to platform,
//! which can move a count or a sample by one (`clippy.toml` keeps them out).

// In the order of dependence.
mod draw;
mod families;
mod draw_log;
mod mix;
pub mod objects;
mod recipe;
mod shard;
pub mod labels;
mod field;
mod contact;
mod friction;
mod pulling_hand;
mod timeline;
mod scenario;
mod film;
mod vibration;
mod accelerometer;
mod unit;
mod finger;
mod generate;
pub mod splits;
pub mod paper;
pub mod plant;

#[cfg(test)]
mod check;
#[cfg(test)]
mod tests;

pub use families::{
    ContactFamily, DisturbanceFamily, FAMILIES, Families, Family, FilmFamily, FrictionFamily, PathFamily,
    SensorFamily, SourceFamily, Stage,
};
pub use generate::{generate, generate_accelerometers, generate_set, plan_frames};
pub use mix::ScenarioChoice;
pub use recipe::{
    ObjectChoice, Platform, Recipe, Region, SECONDS, SPEEDS_MM_S, SynthError, VibrationContent,
    vary_two_of_three,
};
pub use scenario::direction::{SlipDirection, VERTICAL_WITHIN_DEG};
pub use shard::Shard;
pub use splits::{Split, content_hash};
