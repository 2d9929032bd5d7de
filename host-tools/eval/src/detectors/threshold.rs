//! Detectors that are a score and a threshold.

use anyhow::Result;
use slipsense_recording::Episode;

use super::{ClassOrder, Detector, NEVER, Verdict, touched};

/// A score that is computed frame by frame, in order, from what has been seen so far.
pub(crate) trait Score: Send {
    /// The next frame's score; finite.
    fn step(&mut self, episode: &Episode, frame: usize) -> f32;
    /// Start a new stream.
    fn reset(&mut self);
}

/// Slip where the score is above a threshold, the contact rule elsewhere.
pub(super) struct Thresholded<S> {
    name: &'static str,
    score: S,
    threshold: f32,
    order: ClassOrder,
}

impl<S: Score> Thresholded<S> {
    pub(super) const fn new(name: &'static str, score: S, threshold: f32, order: ClassOrder) -> Self {
        Self { name, score, threshold, order }
    }
}

impl<S: Score> Detector for Thresholded<S> {
    fn name(&self) -> &'static str {
        self.name
    }

    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let (score, fallback) = (0..episode.frames())
            .map(|frame| {
                let score = self.score.step(episode, frame);
                let touched = touched(episode, frame);
                let ruled_out = self.order == ClassOrder::ContactFirst && !touched;
                (if ruled_out { NEVER } else { score }, u8::from(touched))
            })
            .unzip();
        Ok(Verdict::new(score, self.threshold, fallback))
    }

    fn reset(&mut self) {
        self.score.reset();
    }
}
