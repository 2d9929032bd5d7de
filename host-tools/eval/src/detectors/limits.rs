//! Detectors that know too little or too much, to give the figures of the others a scale: `majority`,
//! `always-slip`, `clock`, `oracle` and `oracle-label`.

use anyhow::{Context, Result};
use slipsense::params::{CLASSES, FRAME_RATE_HZ};
use slipsense_recording::Episode;
use slipsense_recording::score::SLIP;

use crate::detector::{NEVER, Prediction, touched};
use crate::truth::{SLIDING_FRACTION, SLIDING_MM_S};

/// `majority`: the most frequent class of the training frames, whatever happens; and, of the two classes without
/// slip, the more frequent one. Ties go to the lower class.
fn majority_class(class_frames: [u64; CLASSES]) -> (u8, u8) {
    let fallback = u8::from(class_frames[1] > class_frames[0]);
    (if class_frames[2] > class_frames[usize::from(fallback)] { SLIP } else { fallback }, fallback)
}

/// Score 1 if slip is the most frequent class, else 0; threshold one half.
pub(super) fn majority(episode: &Episode, class_frames: [u64; CLASSES]) -> Prediction {
    let (class, fallback) = majority_class(class_frames);
    Prediction::by_frame(episode.frames(), 0.5, |_| (f32::from(u8::from(class == SLIP)), fallback))
}

/// `always-slip`: slip whenever something is held. It misses nothing and is never late, which shows what latency
/// is worth without false alarms beside it. Score 1 in contact, else 0; threshold one half.
pub(super) fn always_slip(episode: &Episode) -> Prediction {
    Prediction::by_frame(episode.frames(), 0.5, |frame| {
        let touched = u8::from(touched(episode, frame));
        (touched.into(), touched)
    })
}

/// `oracle`: true slip at the interface, from the simulator.
///
/// The encoder's label begins with the crosshead's motion, the interface slips later, when pad, finger and
/// fixture have given way. The oracle's delay against the label is what no detector can be faster than without
/// guessing. The score is the slipping share of the load where the interface moves, else 0.
pub(super) fn oracle(episode: &Episode) -> Result<Prediction> {
    let missing = |array| format!("the oracle needs the simulator's truth, array {array}");
    let speed = episode.slip_true_mm_s.as_ref().with_context(|| missing("slip_true"))?;
    let fraction = episode.slip_fraction.as_ref().with_context(|| missing("slip_fraction"))?;
    Ok(Prediction::by_frame(episode.frames(), SLIDING_FRACTION, |frame| match touched(episode, frame) {
        false => (NEVER, 0),
        true if speed[frame] > SLIDING_MM_S => (fraction[frame], 1),
        true => (0.0, 1),
    }))
}

/// `oracle-label`: the label itself, the ceiling of every figure. Score 1 where it is slip, else 0; threshold one
/// half.
pub(super) fn oracle_label(episode: &Episode) -> Result<Prediction> {
    let label = episode.label.as_ref().context("array label is missing")?;
    Ok(Prediction::by_frame(episode.frames(), 0.5, |frame| {
        (f32::from(u8::from(label[frame] == SLIP)), label[frame].min(1))
    }))
}

/// Frames of a bin of the clock: a quarter of a second.
pub(crate) const CLOCK_BIN_FRAMES: usize = FRAME_RATE_HZ as usize / 4;

/// `clock`: knows the time since the episode began and nothing else, to show whether the protocol's fixed
/// order of steps gives slip away.
///
/// Frames of each class are counted in bins of a quarter of a second over the training episodes. To each
/// bin the frames of one more episode of average mix are added (60 frames in the classes' overall shares), so that
/// the sparse bins at the end of the longest episodes, and the empty ones beyond, lean to the overall majority. The
/// class is the most frequent one of the bin.
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
            let added = |class: usize| CLOCK_BIN_FRAMES as f64 * class_frames[class] as f64 / all;
            let total = bin.iter().sum::<u64>() as f64 + CLOCK_BIN_FRAMES as f64;
            std::array::from_fn(|class| (bin[class] as f64 + added(class)) / total)
        });
        Self { shares: shares.collect() }
    }

    fn at(&self, frame: usize) -> [f64; CLASSES] {
        self.shares[(frame / CLOCK_BIN_FRAMES).min(self.shares.len() - 1)]
    }

    /// The score is how far slip's share is above the larger of the other two; threshold 0.
    pub(super) fn predict(&self, episode: &Episode) -> Prediction {
        Prediction::by_frame(episode.frames(), 0.0, |frame| {
            let [none, held, slip] = self.at(frame);
            ((slip - none.max(held)) as f32, u8::from(held > none))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_class_by_hand() {
        for (frames, class, fallback) in
            [([576, 188, 237], 0, 0), ([188, 576, 237], 1, 1), ([3, 2, 4], 2, 0), ([2, 3, 4], 2, 1)]
        {
            assert_eq!(majority_class(frames), (class, fallback), "{frames:?}");
        }
    }

    #[test]
    fn the_clocks_shares_by_hand() {
        // 60 frames are added to each bin, 30 + 20 + 10 by the overall shares of 1/2, 1/3, 1/6.
        let clock = Clock::new(&[[540, 0, 0], [0, 0, 40]], [540, 360, 180]);
        for (frame, expected) in [
            (0, [570.0 / 600.0, 20.0 / 600.0, 10.0 / 600.0]),
            (59, clock.at(0)),
            (60, [0.3, 0.2, 0.5]),
            (120, [1.0 / 2.0, 1.0 / 3.0, 1.0 / 6.0]),
            (1_000_000, clock.at(120)),
        ] {
            for (f, e) in clock.at(frame).iter().zip(expected) {
                assert!((f - e).abs() < 1e-12, "{frame}: {f} {e}");
            }
        }
    }
}
