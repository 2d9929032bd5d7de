//! Changes that leave the truth as it is, the same for all frames of a sequence and sensor: others would invent motion.

mod mel;
mod pad;

pub use mel::{MelChange, Sound};
pub use pad::{PadChange, SlowArray};
