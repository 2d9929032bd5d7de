//! How far a stand's clock is ahead of a recording's, from knocks that both have seen.
//!
//! Both signals become trains of knocks, and the trains are cross-correlated: the offset at which most
//! knocks fall together wins, if no other comes near.

use slipsense::params::FRAME_RATE_HZ;

use super::LabelError;
use super::rule::ONSET_MM;
use super::stand_log::StandLog;
use crate::Episode;

/// Knocks closer than this are one (s): it rings.
const APART_S: f64 = 0.1;
/// A knock exceeds the signal's median by this number of median deviations.
const STANDS_OUT: f64 = 8.0;
/// Only the strongest are looked at: what is left is footsteps and jaws.
const MOST_KNOCKS: usize = 8;
/// Two knocks fall together if they are about this far apart at most, and half a reading of the log (s).
const TOGETHER_S: f64 = 0.005;
/// Knocks that must fall together.
const MUST_MATCH: usize = 2;
/// The next best offset must reach less than this share of the best one's score.
const RIVAL_MAX: f64 = 0.75;

/// The offset that was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// What the stand's clock showed when the recording began, s.
    pub offset_s: f64,
    /// Knocks that fall together, at least 2.
    pub matched: usize,
    /// 1 less the share of the score that the next best offset has: 0 could as well be another, 1 no other
    /// has any knock together. Two knocks alone give 0.5.
    pub confidence: f64,
}

/// Times of the strongest knocks (s, at most 8, in order) that any accelerometer feels in the first
/// `within_s` of a recording, on its clock.
pub fn recorded_knocks(episode: &Episode, within_s: f64) -> Vec<f64> {
    let rate_hz = f64::from(FRAME_RATE_HZ);
    let frames = episode.frames().min((within_s * rate_hz) as usize);
    let strongest = |frame: usize| {
        let sensors = (0..episode.sensors).map(|sensor| {
            let batch = episode.xl_batch(frame, sensor);
            // What changes from sample to sample: gravity and slow movements do not knock.
            let jerk = |pair: &[[i16; 3]]| -> f64 {
                pair[0].iter().zip(&pair[1]).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).sum()
            };
            let jerks = batch.windows(2).map(jerk).enumerate();
            let (at, jerk) = jerks.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, 0.0));
            let share = (at as f64 + 1.5) / batch.len().max(1) as f64;
            ((frame as f64 + share) / rate_hz, jerk)
        });
        sensors.max_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or_default()
    };
    peaks(&(0..frames).map(strongest).collect::<Vec<_>>())
}

/// Times of the strongest knocks (s, at most 8, in order) on the load cell in the first `within_s` of a
/// log and before its crosshead moves, on its clock.
pub fn logged_knocks(log: &StandLog, within_s: f64) -> Result<Vec<f64>, LabelError> {
    let load_n = log.load_n.as_ref().ok_or_else(|| {
        LabelError("has no load column (such as \"Load [N]\"), needed to see knocks".to_owned())
    })?;
    let at_rest = |i: usize| {
        (log.travel_mm[i] - log.travel_mm[0]).abs() <= ONSET_MM && log.time_s[i] <= log.time_s[0] + within_s
    };
    let rest = (0..load_n.len()).take_while(|&i| at_rest(i)).count();
    // The load's slow part is not a knock. A mean around each reading would see a knock beside it too.
    let around = ((APART_S * log.rate_hz()).ceil() as usize).max(1);
    let above = |i: usize| {
        let near = &load_n[i.saturating_sub(around)..(i + around + 1).min(rest)];
        (load_n[i] - median(near.to_vec())).abs()
    };
    Ok(peaks(&(0..rest).map(|i| (log.time_s[i], above(i))).collect::<Vec<_>>()))
}

/// Offset of the log's clock from the recording's by their knocks, s. `reading_s`: time between two
/// readings of the log.
pub fn align(recorded: &[f64], logged: &[f64], reading_s: f64) -> Result<Alignment, LabelError> {
    let width_s = TOGETHER_S + reading_s / 2.0;
    let differences: Vec<f64> = recorded.iter().flat_map(|r| logged.iter().map(move |l| l - r)).collect();
    let score = |offset_s: f64| -> f64 {
        differences.iter().map(|d| (-0.5 * ((d - offset_s) / width_s).powi(2)).exp()).sum()
    };
    let best_of = |far_from: Option<f64>| {
        let candidates =
            differences.iter().filter(|d| far_from.is_none_or(|best| (*d - best).abs() > 3.0 * width_s));
        candidates.map(|&d| (score(d), d)).max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let no_match = || {
        LabelError(format!(
            "no two knocks fall together: the accelerometers have {} in the first seconds, the load has {} before \
             the crosshead moves; give --offset-s instead",
            recorded.len(),
            logged.len()
        ))
    };
    let (best, best_s) = best_of(None).ok_or_else(no_match)?;
    let together: Vec<f64> =
        differences.iter().copied().filter(|d| (d - best_s).abs() <= 2.0 * width_s).collect();
    if together.len() < MUST_MATCH {
        return Err(no_match());
    }
    let offset_s = together.iter().sum::<f64>() / together.len() as f64;
    let rival = best_of(Some(best_s));
    if let Some((_, rival_s)) = rival.filter(|(rival, _)| *rival > RIVAL_MAX * best) {
        return Err(LabelError(format!(
            "the knocks fit at an offset of {offset_s:.3} s and nearly as well at {rival_s:.3} s: ambiguous; give \
             --offset-s instead"
        )));
    }
    let confidence = 1.0 - rival.map_or(0.0, |(rival, _)| rival / best);
    Ok(Alignment { offset_s, matched: together.len(), confidence })
}

/// Times of the strongest points that stand out, in order of time. `signal`: time (s) and strength.
fn peaks(signal: &[(f64, f64)]) -> Vec<f64> {
    if signal.is_empty() {
        return Vec::new();
    }
    let usual = median(signal.iter().map(|s| s.1).collect());
    let deviation = median(signal.iter().map(|s| (s.1 - usual).abs()).collect());
    let mut strongest: Vec<(f64, f64)> =
        signal.iter().copied().filter(|s| s.1 > usual + STANDS_OUT * deviation && s.1 > 0.0).collect();
    strongest.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut times: Vec<f64> = Vec::new();
    for (time, _) in strongest {
        if times.len() < MOST_KNOCKS && times.iter().all(|t| (t - time).abs() >= APART_S) {
            times.push(time);
        }
    }
    times.sort_by(f64::total_cmp);
    times
}

/// The middle one of some values; of an even number the upper.
fn median(mut values: Vec<f64>) -> f64 {
    let at = values.len() / 2;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_knocks_among_others_give_the_offset() {
        let found = align(&[0.5, 1.31, 4.0, 6.2], &[10.502, 11.309], 0.01).unwrap();
        assert!((found.offset_s - 10.0).abs() < 0.005, "{found:?}");
        assert_eq!(found.matched, 2);
        assert!((0.4..0.6).contains(&found.confidence), "{found:?}");
    }

    #[test]
    fn knocks_that_fit_twice_or_never_are_refused() {
        // The same distance occurs twice in the recording.
        let error = align(&[0.5, 1.3, 3.0, 3.8], &[10.5, 11.3], 0.01).unwrap_err().to_string();
        assert!(error.contains("nearly as well at") && error.contains("ambiguous"), "{error}");
        for (recorded, logged) in [(&[][..], &[1.0][..]), (&[1.0, 2.0], &[1.0]), (&[1.0, 2.0], &[1.0, 3.0])] {
            let error = align(recorded, logged, 0.01).unwrap_err().to_string();
            let counts = (format!("have {} in", recorded.len()), format!("has {} before", logged.len()));
            assert!(error.contains(&counts.0) && error.contains(&counts.1), "{error}");
        }
    }

    #[test]
    fn peaks_are_the_strongest_that_stand_out() {
        let mut signal: Vec<(f64, f64)> = (0..2000).map(|i| (i as f64 * 0.001, f64::from(i % 7))).collect();
        signal[300].1 = 90.0;
        signal[320].1 = 80.0;
        signal[900].1 = 70.0;
        assert_eq!(peaks(&signal), [0.3, 0.9]);
    }
}
