//! Classes of what goes on besides slip, and which one an alarm is put down to.

use slipsense::params::FRAME_RATE_HZ;

use crate::truth::Disturbance;

/// Classes by precedence: where several are active, a frame belongs to the first of this list. Short
/// impacts come before what lasts long, and what touches the object before what does not.
pub const CLASSES: [&str; 16] = [
    "tap",
    "set_down",
    "lift",
    "drag",
    "rolling",
    "jaw",
    "close",
    "open",
    "grip_change",
    "pull",
    "move",
    "motion",
    "electrical",
    "ambient",
    "other",
    "none",
];
/// Index of the class of names that the list does not know.
const OTHER: u8 = 14;
/// Index of the class of frames in which nothing goes on.
pub const NONE: u8 = 15;
/// What happened up to this many frames before counts as active, as a structure rings on and windows
/// remember: 150 ms.
pub const LOOK_BACK_FRAMES: usize = FRAME_RATE_HZ as usize * 150 / 1000;

/// The class of each frame: of the events active between 150 ms before it and itself.
pub(crate) fn disturbances(events: &[Disturbance], frames: usize) -> Vec<u8> {
    let mut classes = vec![NONE; frames];
    for event in events {
        let known = CLASSES[..OTHER as usize].iter().position(|&name| name == event.name);
        let class = known.map_or(OTHER, |class| class as u8);
        let frame = |s: f64| (s.max(0.0) * f64::from(FRAME_RATE_HZ)) as usize;
        let start = frame(event.start_s).min(frames);
        let end = (frame(event.end_s) + LOOK_BACK_FRAMES + 1).clamp(start, frames);
        for of_frame in &mut classes[start..end] {
            *of_frame = class.min(*of_frame);
        }
    }
    classes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(name: &str, start_s: f64, end_s: f64) -> Disturbance {
        Disturbance { name: name.to_owned(), start_s, end_s }
    }

    #[test]
    fn an_event_is_active_for_150_ms_more() {
        let classes = disturbances(&[event("tap", 1.0, 1.1)], 480);
        let tap = |f: usize| classes[f] == 0;
        assert_eq!((tap(239), tap(240), tap(264 + 36), tap(264 + 37)), (false, true, true, false));
    }

    #[test]
    fn precedence_does_not_depend_on_the_order() {
        let (long, short) = (event("move", 0.0, 2.0), event("tap", 1.0, 1.1));
        let one = disturbances(&[long.clone(), short.clone()], 480);
        assert_eq!(one, disturbances(&[short, long], 480));
        assert_eq!((CLASSES[one[100] as usize], CLASSES[one[250] as usize]), ("move", "tap"));
    }

    #[test]
    fn unknown_names_are_other_and_the_end_is_cut() {
        let classes = disturbances(&[event("earthquake", 1.9, 9.0)], 480);
        assert_eq!((CLASSES[classes[479] as usize], CLASSES[classes[0] as usize]), ("other", "none"));
        assert_eq!(CLASSES[OTHER as usize], "other");
    }
}
