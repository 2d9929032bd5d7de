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

pub use intervals::{IntervalError, Intervals};
pub use knocks::{Alignment, KnockError, align, logged_knocks, recorded_knocks};
pub use pulls::{Pull, STAND_FRAMES, pulls};
pub use rule::{
    ENCODER_STEP_MM, NO_CONTACT, NO_SLIP, ONSET_MM, SLIP, label, slip_interval, slip_without_contact,
};
pub use stand_log::{AtFrames, StandLog, StandLogError, StandLogProblem};
