//! The paper's baselines: `entropy` (piezo), `mfcc-qda` (accelerometer) and `entropy-and-mfcc` (both).

use anyhow::Result;
use slipsense::sensor::PiezoFrame;
use slipsense_recording::Episode;

use crate::detector::PerSensor;
use crate::fitted::{Cutoff, MfccFit};
use crate::spectrum::XlSpectrum;

const BINS: usize = 32;
/// |ΔP| over peak that the bins span.
const SPAN: f32 = 0.25;
/// Taxels count whose pressure is above this share of the peak: one in 20.
const ACTIVE_ONE_IN: u32 = 20;

/// Entropy of the relative pressure changes of one pad, nat, 0 to ln 32; 0 for an untouched pad.
///
/// The indicator of Hu et al. (2024): the Shannon entropy of the distribution of marker motions under a gel;
/// uniform motion means stick, spread-out motion means partial slip. The paper replaces marker motion by the
/// change of pressure between frames on the 32 × 32 grid, over taxels above 5 % of the peak pressure; it gives
/// no bins. Chosen here, once: magnitudes |ΔP| over the frame's peak, 32 equal bins on \[0, 0.25\], larger ones
/// in the last bin, nats. A quarter of the peak within 4 ms is beyond every grip change; the width of a bin,
/// 0.8 % of the peak, is a few counts of noise at a light grip.
pub(crate) fn entropy_nat(before: &PiezoFrame, now: &PiezoFrame) -> f32 {
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
    let term = |&n: &u32| {
        let share = f64::from(n) / f64::from(active);
        if n == 0 { 0.0 } else { -share * share.ln() }
    };
    histogram.iter().map(term).sum::<f64>() as f32
}

/// The largest [`entropy_nat`] of the pads in each next frame; 0 in the first frame.
pub(crate) fn entropy() -> impl FnMut(&Episode, usize) -> f32 + Send {
    let mut before = PerSensor::<Option<PiezoFrame>>::default();
    move |episode, frame| {
        before.largest(episode.sensors, |before, sensor| {
            let now = episode.piezo(frame, sensor);
            before.replace(now.clone()).map_or(0.0, |before| entropy_nat(&before, now).into())
        })
    }
}

/// 13 MFCC of 26 filters with quadratic discriminants, after Yoo et al. (2021).
///
/// Two classes, slip and not slip, with equal priors: the accelerometer cannot sense contact, and the rarity
/// of slip in a test protocol is nothing to learn. The score is the log of the likelihood ratio, nat, the largest of the
/// sensors.
pub(super) fn mfcc_qda(fit: &MfccFit) -> Result<impl FnMut(&Episode, usize) -> f32 + Send + use<>> {
    let (ratio, mut spectra) = (fit.ratio()?, PerSensor::<XlSpectrum>::default());
    Ok(move |episode: &Episode, frame| {
        spectra.largest(episode.sensors, |spectrum, sensor| {
            spectrum.push_frame(episode, frame, sensor);
            ratio.ln(&spectrum.mfcc())
        })
    })
}

/// The smaller of two scores, each less its threshold and over its standard deviation on train: above 0 exactly where
/// both are above their thresholds.
pub(super) fn both(scores: [f32; 2], cutoffs: [Cutoff; 2]) -> f32 {
    let scaled = |i: usize| (scores[i] - cutoffs[i].threshold) / cutoffs[i].std;
    scaled(0).min(scaled(1))
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
    fn entropies_by_hand() {
        let (ln2, ln3) = (2f32.ln(), 3f32.ln());
        for (before, now, expected, why) in [
            // Peak 1000, a bin is 7.8125 counts: 0 and 7 share bin 0, 8 is in bin 1.
            ([1000, 500, 200], [1000, 507, 208], ln3 - 2.0 / 3.0 * ln2, "shares 2/3 and 1/3"),
            ([750, 0, 0], [1000, 600, 245], 0.0, "the edge of the last bin, far beyond it, and bin 31"),
            ([1000, 0, 0], [1000, 600, 100], ln3, "bins 0, 31 and 12"),
            ([1000, 90, 0], [1000, 50, 0], 0.0, "exactly 5 % of the peak does not count"),
            ([1000, 91, 0], [1000, 51, 0], ln2, "above 5 % counts"),
            ([9, 9, 9], [0, 0, 0], 0.0, "untouched"),
        ] {
            let found = entropy_nat(&frame(before), &frame(now));
            assert!((found - expected).abs() < 1e-6, "{why}: {found} against {expected}");
        }
    }

    #[test]
    fn above_0_exactly_where_both_are_above_their_thresholds() {
        let cutoffs = [Cutoff { threshold: 1.5, std: 0.25 }, Cutoff { threshold: -3.0, std: 10.0 }];
        for (x, y, slip) in [
            (1.6, -2.0, true),
            (1.5, -2.0, false),
            (1.6, -3.0, false),
            (1.4, 50.0, false),
            (9.0, -4.0, false),
        ] {
            assert_eq!(both([x, y], cutoffs) > 0.0, slip, "{x} {y}");
        }
        // (2 − 1.5) / 0.25 = 2 and (7 + 3) / 10 = 1.
        assert_eq!(both([2.0, 7.0], cutoffs), 1.0);
    }
}
