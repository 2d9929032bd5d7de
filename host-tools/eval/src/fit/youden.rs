//! The one rule by which thresholds are fitted: the largest Youden index.

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
    fn thresholds_by_hand() {
        let (yes, no) = (true, false);
        type Case<'a> = (&'a [(f32, bool)], Option<(f32, f64)>);
        let cases: [Case<'_>; 6] = [
            // Above 4: 2 of 3 slips, 0 of 4 others, J = 2/3. Above 2: 3 of 3 and 2 of 4, J = 1/2.
            (
                &[(1.0, no), (6.0, yes), (2.0, no), (5.0, yes), (3.0, yes), (4.0, no), (3.5, no)],
                Some((4.5, 2.0 / 3.0)),
            ),
            // The two scores of 2 cannot be separated. J is 1/2 above 3, and 3/4 above 1.
            (&[(3.0, yes), (2.0, no), (2.0, yes), (1.0, no), (1.0, no), (0.0, no)], Some((1.5, 0.75))),
            // Of equals the highest threshold.
            (&[(4.0, yes), (3.0, no), (2.0, yes), (1.0, no)], Some((3.5, 0.5))),
            // A useless score and a reversed one never fire.
            (&[(1.0, yes), (1.0, no)], Some((1.0, 0.0))),
            (&[(1.0, yes), (2.0, no)], Some((2.0, 0.0))),
            (&[(1.0, yes)], None),
        ];
        for (frames, expected) in cases {
            let found = youden(&mut frames.to_vec()).map(|best| (best.threshold, best.index));
            assert_eq!(found, expected, "{frames:?}");
        }
        // Neighbouring floats are separated.
        let found = youden(&mut [(1.0f32.next_up(), yes), (1.0, no)]).unwrap();
        assert!(1.0f32.next_up() > found.threshold && 1.0 <= found.threshold);
    }
}
