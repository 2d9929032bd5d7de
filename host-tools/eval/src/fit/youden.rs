//! The one rule by which thresholds are fitted: the largest Youden index.

/// A threshold and its Youden index.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Youden {
    /// Slip where the score is above this.
    pub(crate) threshold: f32,
    /// Share of the slip frames above it less share of the other frames above it, −1 to 1.
    pub(crate) index: f64,
}

/// The threshold with the largest J = TPR − FPR, FPR among frames that do not slip; midway between two
/// scores that occur. Of equals the highest threshold, which alarms least. `frames` are (score, is slip),
/// finite; they come back sorted. `None` without slip or without anything else.
pub(crate) fn youden(frames: &mut [(f32, bool)]) -> Option<Youden> {
    let slips = frames.iter().filter(|(_, slip)| *slip).count() as f64;
    let others = frames.len() as f64 - slips;
    if slips == 0.0 || others == 0.0 {
        return None;
    }
    frames.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
    let (mut hits, mut false_hits) = (0.0, 0.0);
    let mut best = Youden { threshold: frames[0].0, index: 0.0 };
    for i in 0..frames.len() {
        let (score, slip) = frames[i];
        if slip {
            hits += 1.0
        } else {
            false_hits += 1.0
        }
        let Some(&(below, _)) = frames.get(i + 1).filter(|(below, _)| *below < score) else {
            continue;
        };
        let index = hits / slips - false_hits / others;
        if index > best.index {
            // Halves first: the sum of two scores may not be finite.
            let midway = score / 2.0 + below / 2.0;
            best = Youden { threshold: if midway < score { midway } else { below }, index };
        }
    }
    Some(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn largest_difference_by_hand() {
        // Above 4: 2 of 3 slips, 0 of 4 others, J = 2/3. Above 2: 3 of 3 and 2 of 4, J = 1/2.
        let mut frames =
            [(1.0, false), (6.0, true), (2.0, false), (5.0, true), (3.0, true), (4.0, false), (3.5, false)];
        let found = youden(&mut frames).unwrap();
        assert_eq!(found, Youden { threshold: 4.5, index: 2.0 / 3.0 });
    }

    #[test]
    fn ties_are_not_cut_and_of_equals_the_highest_wins() {
        // The two scores of 2 cannot be told apart. J is 1/2 above 3, and again above 1.
        let mut frames = [(3.0, true), (2.0, false), (2.0, true), (1.0, false), (1.0, false), (0.0, false)];
        let found = youden(&mut frames).unwrap();
        assert_eq!(found, Youden { threshold: 1.5, index: 0.75 });
        let mut frames = [(4.0, true), (3.0, false), (2.0, true), (1.0, false)];
        assert_eq!(youden(&mut frames).unwrap(), Youden { threshold: 3.5, index: 0.5 });
    }

    #[test]
    fn a_useless_score_never_fires() {
        let mut frames = [(1.0, true), (1.0, false)];
        assert_eq!(youden(&mut frames).unwrap(), Youden { threshold: 1.0, index: 0.0 });
        let mut backwards = [(1.0, true), (2.0, false)];
        assert_eq!(youden(&mut backwards).unwrap(), Youden { threshold: 2.0, index: 0.0 });
        assert_eq!(youden(&mut [(1.0, true)]), None);
    }

    #[test]
    fn neighbouring_floats_are_told_apart() {
        let mut frames = [(1.0f32.next_up(), true), (1.0, false)];
        let found = youden(&mut frames).unwrap();
        assert!(1.0f32.next_up() > found.threshold && 1.0 <= found.threshold);
    }
}
