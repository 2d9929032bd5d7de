//! The one rule by which thresholds are fitted: the largest Youden index.

/// The threshold, slip being above it, with the largest J = TPR − FPR, FPR among frames that do not slip, and that J, −1
/// to 1. It is midway between two scores that occur; of equals the highest, which alarms least. `frames` are (score, is
/// slip), finite; they come back sorted. `None` without slip or without anything else.
pub(crate) fn youden(frames: &mut [(f32, bool)]) -> Option<(f32, f64)> {
    let slips = frames.iter().filter(|(_, slip)| *slip).count() as f64;
    let others = frames.len() as f64 - slips;
    if slips == 0.0 || others == 0.0 {
        return None;
    }
    frames.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(b.1.cmp(&a.1)));
    let (mut hits, mut false_hits) = (0.0, 0.0);
    let mut best = (frames[0].0, 0.0);
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
        if index > best.1 {
            // Halves first: the sum of two scores may not be finite.
            let midway = score / 2.0 + below / 2.0;
            best = (if midway < score { midway } else { below }, index);
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
            assert_eq!(youden(&mut frames.to_vec()), expected, "{frames:?}");
        }
        // Neighbouring floats are separated.
        let (threshold, _) = youden(&mut [(1.0f32.next_up(), yes), (1.0, no)]).unwrap();
        assert!(1.0f32.next_up() > threshold && 1.0 <= threshold);
    }
}
