//! Frame by frame, by hand.

use super::*;
use crate::metrics::groups::groupings;

#[test]
fn contact_only_and_guard_band_by_hand() {
    let mut episode = episode(100, &[40..60]);
    episode.label.as_mut().unwrap()[..20].fill(0);
    // No contact right but for 5 frames of slip; slip from 41 to 61.
    let mut class = class(100, &[10..15, 41..61]);
    for f in (0..20).filter(|f| !(10..15).contains(f)) {
        class[f] = 0;
    }
    let frame = Figures::new([&EpisodeRecord::new(&truth(&episode), &class)]).frame;
    assert_eq!(frame.confusion_frames, [[15, 0, 5], [0, 59, 1], [0, 1, 19]]);
    assert_eq!(frame.accuracy_share, Some(0.93));
    assert_eq!(frame.fpr_of_non_slip_share, Some(6.0 / 80.0));
    assert_eq!(frame.fpr_of_all_share, Some(6.0 / 100.0));
    let contact = &frame.contact_only_slip;
    assert_eq!((contact.precision_share, contact.recall_share), (Some(0.95), Some(0.95)));
    // 38 to 42 and 58 to 62 are left out, and with them both errors at the boundaries.
    assert_eq!(frame.guard_band.frames, 92);
    assert_eq!(frame.guard_band.accuracy_share, Some(87.0 / 92.0));
    assert_eq!(frame.guard_band.fpr_of_non_slip_share, Some(5.0 / 76.0));
}

#[test]
fn a_false_slip_frame_is_before_after_or_elsewhere() {
    // The 50 ms after the first slip reach into those before the second, which come first.
    let episode = episode(200, &[40..60, 80..90]);
    let figures = figures(&episode, &[10..13, 27..30, 35..62, 66..70, 101..105]);
    let share = |frames: usize| Some(frames as f64 / 170.0);
    let parts = figures.false_slip;
    assert_eq!(parts.fpr_before_slip_share, share(2 + 5 + 2), "28, 29, 35 to 39, 68, 69");
    assert_eq!(parts.fpr_after_slip_share, share(2 + 2 + 1), "60, 61, 66, 67, 101");
    assert_eq!(parts.fpr_elsewhere_share, share(3 + 1 + 3), "10 to 12, 27, 102 to 104");
    assert_eq!(figures.frame.fpr_of_non_slip_share, share(21));
    assert_eq!(Figures::new([]).false_slip.fpr_elsewhere_share, None);
}

#[test]
fn the_worst_group_is_one_with_slip() {
    let slips = with(episode(100, &[40..60]), "speed_mm_s", 2.into());
    let still = episode(100, &[]);
    let [slips, still] =
        [(&slips, 45..60), (&still, 50..51)].map(|(e, flags)| (truth(e), record(e, &[flags])));
    let f1 = |of: &(Truth, EpisodeRecord)| Figures::new([&of.1]).frame.macro_f1;
    assert!(f1(&still) < Some(0.5) && f1(&slips) > Some(0.9), "one frame of false slip");
    let groupings = groupings(&[&still, &slips].map(|(truth, record)| (truth, record)));
    let by_speed = groupings.into_iter().find(|grouping| grouping.by == "speed").unwrap();
    assert_eq!(by_speed.worst.as_deref(), Some("2 mm/s"));
}
