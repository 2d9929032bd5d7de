//! Labels for recordings: which frames are slip, from a test stand's log or from a person's intervals.
//!
//! A test stand's export ([`StandLog`]) is brought onto the recording's clock ([`align`] finds by how much,
//! from knocks that both have seen), resampled to frames, and cut into movements ([`pulls`]), to each of
//! which the paper's rule applies ([`slip_interval`]). Without a stand, a person names intervals
//! ([`Intervals`]). The pads decide contact either way ([`label`]).

mod rule;
mod header;
mod stand_log;
mod pulls;
mod knocks;
mod intervals;

pub use intervals::Intervals;
pub use knocks::{Alignment, align, logged_knocks, recorded_knocks};
pub use pulls::{Pull, STAND_FRAMES, pulls};
pub use rule::{
    ENCODER_STEP_MM, NO_CONTACT, NO_SLIP, ONSET_MM, SLIP, label, slip_interval, slip_without_contact,
};
pub use stand_log::{AtFrames, StandLog};

/// What is wrong with what labels are made from: the rule that is broken, with the place where there is one, in one line.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct LabelError(String);
