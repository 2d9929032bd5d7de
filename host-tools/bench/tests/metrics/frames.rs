//! Frame by frame, by hand.

use super::*;

#[test]
fn contact_only_and_guard_band_by_hand() {
    let mut episode = episode(100, &[40..60]);
    episode.label.as_mut().unwrap()[..20].fill(0);
    // No contact right but for 5 frames of slip; slip from 41 to 61.
    let mut class = class(100, &[10..15, 41..61]);
    for f in (0..20).filter(|f| !(10..15).contains(f)) {
        class[f] = 0;
    }
    let frame = Figures::new([&Record::new(&truth(&episode), &class)]).frame;
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
