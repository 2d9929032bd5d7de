//! `clock`: knows the time since the episode began and nothing else, to show whether the protocol's fixed
//! order of steps gives slip away.
//!
//! Frames of each class are counted in bins of a quarter of a second over the training episodes. To each
//! bin the frames of one more episode of average mix are added (60 frames shared out by the classes'
//! overall shares), so that the sparse bins at the end of the longest episodes, and the empty ones beyond,
//! lean to the overall majority. The class is the most frequent one of the bin.

use anyhow::Result;
use slipsense::params::{CLASSES, FRAME_RATE_HZ};
use slipsense_recording::Episode;

use super::{Detector, Verdict};

/// Frames of a bin: a quarter of a second.
pub(crate) const BIN_FRAMES: usize = FRAME_RATE_HZ as usize / 4;

pub(super) struct Clock {
    /// Share of each class in each bin, the last one for all later times.
    shares: Vec<[f64; CLASSES]>,
}

impl Clock {
    /// From the frames of each class in each bin, and in all.
    pub(super) fn new(bins: &[[u64; CLASSES]], class_frames: [u64; CLASSES]) -> Self {
        let all = class_frames.iter().sum::<u64>().max(1) as f64;
        let beyond = [0; CLASSES];
        let shares = bins.iter().chain([&beyond]).map(|bin| {
            let added = |class: usize| BIN_FRAMES as f64 * class_frames[class] as f64 / all;
            let total = bin.iter().sum::<u64>() as f64 + BIN_FRAMES as f64;
            std::array::from_fn(|class| (bin[class] as f64 + added(class)) / total)
        });
        Self { shares: shares.collect() }
    }

    fn at(&self, frame: usize) -> [f64; CLASSES] {
        self.shares[(frame / BIN_FRAMES).min(self.shares.len() - 1)]
    }
}

impl Detector for Clock {
    fn name(&self) -> &'static str {
        "clock"
    }

    /// The score is how far slip's share is above the larger of the other two; threshold 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let (score, fallback) = (0..episode.frames())
            .map(|frame| {
                let [none, held, slip] = self.at(frame);
                ((slip - none.max(held)) as f32, u8::from(held > none))
            })
            .unzip();
        Ok(Verdict::new(score, 0.0, fallback))
    }

    fn reset(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_by_hand() {
        // 60 frames are added to each bin, 30 + 20 + 10 by the overall shares of 1/2, 1/3, 1/6.
        let clock = Clock::new(&[[540, 0, 0], [0, 0, 40]], [540, 360, 180]);
        let near = |found: [f64; 3], expected: [f64; 3]| {
            for (f, e) in found.iter().zip(expected) {
                assert!((f - e).abs() < 1e-12, "{found:?} {expected:?}");
            }
        };
        near(clock.at(0), [570.0 / 600.0, 20.0 / 600.0, 10.0 / 600.0]);
        near(clock.at(59), clock.at(0));
        near(clock.at(60), [0.3, 0.2, 0.5]);
        near(clock.at(120), [1.0 / 2.0, 1.0 / 3.0, 1.0 / 6.0]);
        near(clock.at(1_000_000), clock.at(120));
    }
}
