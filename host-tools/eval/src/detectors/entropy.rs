//! `entropy`: the paper's piezo baseline, the entropy indicator of Hu et al. (2024) on pressure changes.
//!
//! Hu et al. take the Shannon entropy of the distribution of marker motions under a gel: uniform motion
//! means stick, spread-out motion means partial slip. The paper replaces marker motion by the change of
//! pressure between frames on the 32 × 32 grid, over taxels above 5 % of the peak pressure; it gives no
//! bins. Chosen here, once: magnitudes |ΔP| over the frame's peak, 32 equal bins on \[0, 0.25\], larger
//! ones in the last bin, nats. A quarter of the peak within 4 ms is beyond every grip change; the width of
//! a bin, 0.8 % of the peak, is a few counts of noise at a light grip.

use slipsense::sensor::PiezoFrame;
use slipsense_recording::Episode;

use super::PerSensor;
use super::threshold::Score;

const BINS: usize = 32;
/// |ΔP| over peak that the bins span.
const SPAN: f32 = 0.25;
/// Taxels count whose pressure is above this share of the peak: one in 20.
const ACTIVE_ONE_IN: u32 = 20;

/// Entropy of the relative pressure changes of one pad, nat, 0 to ln 32; 0 for an untouched pad.
pub fn entropy_nat(before: &PiezoFrame, now: &PiezoFrame) -> f32 {
    let peak = now.counts().iter().copied().max().unwrap_or(0);
    if peak == 0 {
        return 0.0;
    }
    let mut histogram = [0u32; BINS];
    let bins_per_count = BINS as f32 / SPAN / f32::from(peak);
    let mut active = 0u32;
    for (&count, &old) in now.counts().iter().zip(before.counts()) {
        if u32::from(count) * ACTIVE_ONE_IN > u32::from(peak) {
            let bin = (f32::from(count.abs_diff(old)) * bins_per_count) as usize;
            histogram[bin.min(BINS - 1)] += 1;
            active += 1;
        }
    }
    let of_bin = |&n: &u32| {
        let share = f64::from(n) / f64::from(active);
        if n == 0 { 0.0 } else { -share * share.ln() }
    };
    histogram.iter().map(of_bin).sum::<f64>() as f32
}

/// The largest entropy of all pads. The first frame of a stream has no change: 0.
#[derive(Clone, Debug)]
pub(crate) struct EntropyScore {
    before: PerSensor<Option<PiezoFrame>>,
}

impl EntropyScore {
    pub(crate) const fn new() -> Self {
        Self { before: PerSensor::new() }
    }
}

impl Score for EntropyScore {
    fn step(&mut self, episode: &Episode, frame: usize) -> f32 {
        let before = self.before.of(episode.sensors, || None);
        let mut largest = 0f32;
        for (sensor, before) in before.iter_mut().enumerate() {
            let now = episode.piezo(frame, sensor);
            if let Some(before) = before {
                largest = largest.max(entropy_nat(before, now));
            }
            *before = Some(now.clone());
        }
        largest
    }

    fn reset(&mut self) {
        self.before.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::params::TAXELS;

    fn frame(counts: [u16; 3]) -> PiezoFrame {
        let mut all = [0; TAXELS];
        all[500..503].copy_from_slice(&counts);
        PiezoFrame::from_scan(all)
    }

    #[test]
    fn three_taxels_by_hand() {
        // Peak 1000, a bin is 7.8125 counts. Changes 0 and 7 share bin 0, 8 is in bin 1:
        // H = ln 3 − (2/3) ln 2 = 0.6365 nat.
        let expected = 3f32.ln() - 2.0 / 3.0 * 2f32.ln();
        let found = entropy_nat(&frame([1000, 500, 200]), &frame([1000, 507, 208]));
        println!("entropy of shares 2/3 and 1/3: {found} nat, by hand {expected}");
        assert!((found - expected).abs() < 1e-6);
    }

    #[test]
    fn changes_beyond_the_span_share_the_last_bin() {
        // 250 of 1000 is the edge of the last bin, 600 is far beyond, 245 is bin 31 as well.
        assert_eq!(entropy_nat(&frame([750, 0, 0]), &frame([1000, 600, 245])), 0.0);
        let apart = entropy_nat(&frame([1000, 0, 0]), &frame([1000, 600, 100]));
        assert!((apart - 3f32.ln()).abs() < 1e-6, "bins 0, 31 and 12: {apart}");
    }

    #[test]
    fn a_taxel_at_5_percent_does_not_count_and_one_above_does() {
        // 50 of 1000 is exactly 5 %.
        assert_eq!(entropy_nat(&frame([1000, 90, 0]), &frame([1000, 50, 0])), 0.0);
        let two = entropy_nat(&frame([1000, 91, 0]), &frame([1000, 51, 0]));
        assert!((two - 2f32.ln()).abs() < 1e-6);
    }

    #[test]
    fn an_untouched_pad_has_none() {
        assert_eq!(entropy_nat(&frame([9, 9, 9]), &frame([0, 0, 0])), 0.0);
    }
}
