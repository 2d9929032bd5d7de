//! The rule that labels frames, after the paper's rig: slip is where the crosshead has moved, contact is
//! what the pads say. One definition for the generator and for recordings.

use std::ops::Range;

use slipsense::params::CONTACT_SUM_MIN;
use slipsense::sensor::PiezoFrame;

/// Resolution of the crosshead encoder (paper).
pub const ENCODER_STEP_MM: f64 = 0.02;
/// Cumulative displacement that starts a slip (paper), and that must remain for it to go on.
pub const ONSET_MM: f64 = 0.07;

/// No sensor is touched.
pub const NO_CONTACT: u8 = 0;
/// Contact outside the slip interval.
pub const NO_SLIP: u8 = 1;
/// Contact inside the slip interval.
pub const SLIP: u8 = 2;

/// A position in whole steps of [`ENCODER_STEP_MM`], the nearest one.
pub(crate) fn encoder_steps(mm: f32) -> i64 {
    (f64::from(mm) / ENCODER_STEP_MM).round() as i64
}

/// Frames of the slip interval: from the first frame more than [`ONSET_MM`] away from the start, to
/// before the first frame from which less than [`ONSET_MM`] of travel remains. Empty if it never moves.
pub fn slip_interval(displacement_mm: &[f32]) -> Range<usize> {
    // Encoder steps are exact in units of a step, not in millimetres.
    let step = |mm: f32| encoder_steps(mm) as f64 * ENCODER_STEP_MM;
    let (Some(&first), Some(&last)) = (displacement_mm.first(), displacement_mm.last()) else {
        return 0..0;
    };
    let moved = |mm: f32| (step(mm) - step(first)).abs();
    let remains = |mm: f32| (step(last) - step(mm)).abs();
    let Some(onset) = displacement_mm.iter().position(|&mm| moved(mm) > ONSET_MM) else {
        return 0..0;
    };
    let end = displacement_mm.iter().rposition(|&mm| remains(mm) >= ONSET_MM).map_or(0, |f| f + 1);
    onset..end.max(onset)
}

/// Labels of all frames. A frame has contact when at least one of its `sensors` scans sums to
/// [`CONTACT_SUM_MIN`]; without contact it is [`NO_CONTACT`] even inside a slip interval.
pub fn label(piezo: &[PiezoFrame], sensors: usize, slips: &[Range<usize>]) -> Vec<u8> {
    piezo
        .chunks_exact(sensors)
        .enumerate()
        .map(|(frame, scans)| {
            let touched = scans.iter().any(|scan| scan.sum() >= CONTACT_SUM_MIN);
            match (touched, slips.iter().any(|s| s.contains(&frame))) {
                (false, _) => NO_CONTACT,
                (true, false) => NO_SLIP,
                (true, true) => SLIP,
            }
        })
        .collect()
}

/// Frames that lie in a slip interval and are labelled [`NO_CONTACT`] all the same.
pub fn slip_without_contact(labels: &[u8], slips: &[Range<usize>]) -> usize {
    slips.iter().flat_map(|s| &labels[s.clone()]).filter(|&&l| l == NO_CONTACT).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::params::TAXELS;

    fn scan(sum: u16) -> PiezoFrame {
        let mut counts = [0; TAXELS];
        counts[500] = sum;
        PiezoFrame::from_scan(counts)
    }

    #[test]
    fn the_interval_starts_above_and_ends_below_0_07_mm() {
        // 0.06 is not more than 0.07, 0.08 is; of 0.40 in total, 0.34 leaves 0.06, 0.32 leaves 0.08.
        let mm = [0.0, 0.0, 0.02, 0.06, 0.08, 0.2, 0.32, 0.34, 0.4, 0.4];
        assert_eq!(slip_interval(&mm), 4..7);
        let down: Vec<f32> = mm.iter().map(|x| 5.0 - x).collect();
        assert_eq!(slip_interval(&down), 4..7);
    }

    #[test]
    fn a_move_below_the_threshold_is_no_slip() {
        assert!(slip_interval(&[0.0, 0.02, 0.04, 0.06]).is_empty());
        assert!(slip_interval(&[]).is_empty());
        // 0.08 in all: when it has moved enough to start, too little remains to go on.
        assert!(slip_interval(&[0.0, 0.04, 0.08]).is_empty());
    }

    #[test]
    fn contact_has_precedence_and_one_touched_sensor_is_enough() {
        let piezo = [scan(941), scan(0), scan(941), scan(942), scan(942), scan(3000), scan(0), scan(0)];
        let slip = 1..4;
        let labels = label(&piezo, 2, std::slice::from_ref(&slip));
        assert_eq!(labels, [NO_CONTACT, SLIP, SLIP, NO_CONTACT]);
        assert_eq!(slip_without_contact(&labels, std::slice::from_ref(&slip)), 1);
        assert_eq!(label(&piezo, 2, &[]), [NO_CONTACT, NO_SLIP, NO_SLIP, NO_CONTACT]);
    }
}
