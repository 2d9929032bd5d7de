//! Detectors that the benchmark compares.

use anyhow::Result;
use slipsense_episode::Episode;

/// What a detector says about one episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Class of each frame: 0 no contact, 1 contact without slip, 2 slip.
    pub class: Vec<u8>,
    /// Slip score of each frame, higher is more like slip, in the detector's own unit: what the
    /// operating curve sweeps a threshold over. Finite.
    pub score: Vec<f32>,
    /// Compute time per frame is the benchmark's to measure; this is the score at which the detector
    /// itself says slip.
    pub threshold: f32,
}

/// A causal detector. It is handed the episodes of a stream in order and may carry state from one to the
/// next, as a module that is never switched off does.
pub trait Detector: Send {
    /// Name as on the command line.
    fn name(&self) -> &'static str;
    /// Judge the frames of the next episode of the stream. A frame's verdict must not depend on later
    /// frames.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict>;
    /// Start a new stream.
    fn reset(&mut self);
}
