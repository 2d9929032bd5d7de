//! What the detector is to say of each frame of an episode: not the label of the rig, which calls slip what does not
//! slide yet, but whether the contact as a whole slides and goes on sliding.

use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::Episode;
use slipsense_recording::score::{MARGIN_FRAMES, SLIP, runs};
use slipsense_synth::labels::{mostly_sliding, sustained_sliding};

/// What the detector is to say of a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Target {
    #[default]
    Still,
    /// The contact slides, for 50 ms or longer in all and by [`TRAVEL_MM`] or more.
    Slides,
    /// The label says slip and the contact does not slide as a whole yet: to say so is right, not to say so no fault.
    Begins,
    /// Does not count: jerks too short or too small to be an event, where most of the contact slides but not all of it,
    /// the frames just before, and what rings on behind.
    Either,
}

/// Travel of an event, mm: an object creeps by less before it is held again, and nothing can be felt of it.
const TRAVEL_MM: f32 = 0.2;
/// Frames before sliding that do not count.
const BEFORE_FRAMES: usize = 4;

/// The targets of an episode's frames. Where the episode does not know the interface, its label is all there is.
pub fn targets(episode: &Episode, label: &[u8]) -> Vec<Target> {
    let frames = label.len();
    let by_label = |&label: &u8| if label == SLIP { Target::Begins } else { Target::Still };
    let mut targets: Vec<Target> = label.iter().map(by_label).collect();
    let known = episode.slip_true_mm_s.as_ref().zip(episode.slip_fraction.as_ref());
    let (sliding, partial) = match known {
        Some((speed, fraction)) => {
            let travel_mm =
                |&(start, end): &(usize, usize)| speed[start..end].iter().sum::<f32>() / FRAME_RATE_HZ as f32;
            let (mut sliding, _) = sustained_sliding(speed, fraction);
            sliding.retain(|interval| travel_mm(interval) >= TRAVEL_MM);
            (sliding, mostly_sliding(speed, fraction))
        }
        None => (runs(frames, |f| label[f] == SLIP), Vec::new()),
    };
    let around =
        |(start, end): (usize, usize)| start.saturating_sub(BEFORE_FRAMES)..(end + MARGIN_FRAMES).min(frames);
    for interval in partial.into_iter().chain(sliding.iter().copied()) {
        for target in &mut targets[around(interval)] {
            if *target == Target::Still {
                *target = Target::Either;
            }
        }
    }
    // A label that outlasts the sliding says nothing of it.
    let mut slid = false;
    for frame in 0..frames {
        if frame > 0 && label[frame - 1] != SLIP {
            slid = false;
        }
        slid |= sliding.iter().any(|&(start, end)| (start..end).contains(&frame));
        if slid && targets[frame] == Target::Begins {
            targets[frame] = Target::Either;
        }
    }
    for (start, end) in sliding {
        targets[start..end].fill(Target::Slides);
    }
    targets
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a second at a speed and a share of the load, no slip by the label.
    fn of_contact(speed_mm_s: impl Fn(usize) -> f32, share: impl Fn(usize) -> f32) -> Vec<Target> {
        let frames = FRAME_RATE_HZ as usize;
        let episode = Episode {
            slip_true_mm_s: Some((0..frames).map(speed_mm_s).collect()),
            slip_fraction: Some((0..frames).map(share).collect()),
            ..Episode::default()
        };
        targets(&episode, &vec![1; frames])
    }

    #[test]
    fn what_slides_for_the_most_part_does_not_count() {
        let slides = |f: usize| if (100..150).contains(&f) { 2.0 } else { 0.0 };
        let partly = of_contact(slides, |_| 0.8);
        assert!(partly[..96].iter().chain(&partly[162..]).all(|&target| target == Target::Still));
        assert!(partly[96..162].iter().all(|&target| target == Target::Either));
        let whole = of_contact(slides, |_| 1.0);
        assert!(whole[100..150].iter().all(|&target| target == Target::Slides));
        assert_eq!((whole[99], whole[150]), (Target::Either, Target::Either));
        let little = of_contact(slides, |_| 0.5);
        assert!(little.iter().all(|&target| target == Target::Still));
    }
}
