//! Frame by frame: how many frames got the right class.
//!
//! * *Accuracy*: share of frames whose class is right. *Macro F1*: unweighted mean of the F1 of the three
//!   classes (of those that occur or are predicted).
//! * *FPR*: frames falsely called slip, as a share of the frames that do not slip (the headline), or of
//!   all frames. The paper does not say which it means; its Table 1 leaves only the former: an FPR of
//!   22.98 % of all frames cannot stand beside an accuracy of 79.41 %.
//! * *False slip*: the FPR by where the frames lie: up to 50 ms before an onset, where a flag is early; up to
//!   50 ms after an end, where it lasts; or elsewhere, where nothing explains it.
//! * *Contact only*: precision, recall and F1 of slip among the frames with contact by the label. No
//!   contact is a rule on the pressure sum that label and detector may share, so it is won for free.
//! * *Guard band*: the frames up to 2 beside an onset or end of slip are left out; the encoder's steps and
//!   the clocks cannot place the boundary better.

use serde::Serialize;
use slipsense::params::CLASSES;
use slipsense_recording::score::{ClassScores, MARGIN_FRAMES, SLIP};

use super::statistics::share;
use crate::truth::Truth;

const GUARD_FRAMES: usize = 2;

pub(crate) const CLASS_NAMES: [&str; CLASSES] = ["no_contact", "no_slip", "slip"];

/// Counts of one episode; they add up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    pub(crate) all: ClassScores,
    guarded: ClassScores,
    /// Frames falsely called slip up to 50 ms before an onset; up to 50 ms after an end, and not before the next
    /// onset; elsewhere.
    false_slip: [usize; 3],
}

impl FrameCounts {
    pub fn new(truth: &Truth, class: &[u8]) -> Self {
        let frames = truth.frames();
        let mut counts = Self { all: ClassScores::new(&truth.label, class), ..Self::default() };
        counts.guarded = counts.all;
        let mark = |marked: &mut [bool], from: usize, to: usize| marked[from..to.min(frames)].fill(true);
        let [mut before, mut after, mut guard] = std::array::from_fn(|_| vec![false; frames]);
        for &(onset, end) in &truth.slip {
            mark(&mut before, onset.saturating_sub(MARGIN_FRAMES), onset);
            mark(&mut after, end, end + MARGIN_FRAMES);
            for boundary in [onset, end] {
                mark(&mut guard, boundary.saturating_sub(GUARD_FRAMES), boundary + GUARD_FRAMES);
            }
        }
        for f in 0..frames {
            let (label, class) = (truth.label[f], class[f]);
            if guard[f] {
                counts.guarded.confusion[label as usize][class as usize] -= 1;
            }
            if class == SLIP && label != SLIP {
                let place = match (before[f], after[f]) {
                    (true, _) => 0,
                    (_, true) => 1,
                    _ => 2,
                };
                counts.false_slip[place] += 1;
            }
        }
        counts
    }

    pub(crate) fn add(&mut self, other: &Self) {
        self.all.add(&other.all);
        self.guarded.add(&other.guarded);
        self.false_slip.iter_mut().zip(other.false_slip).for_each(|(sum, frames)| *sum += frames);
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrameFigures {
    /// `[truth][predicted]`, classes no contact, no slip, slip.
    pub(crate) confusion_frames: [[u64; CLASSES]; CLASSES],
    pub(crate) accuracy_share: Option<f64>,
    pub(crate) macro_f1: Option<f64>,
    pub(crate) classes: Vec<ClassFigures>,
    pub(crate) fpr_of_non_slip_share: Option<f64>,
    pub(crate) fpr_of_all_share: Option<f64>,
    pub(crate) contact_only_slip: ClassFigures,
    pub(crate) guard_band: GuardFigures,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct ClassFigures {
    pub(crate) name: &'static str,
    pub(crate) precision_share: Option<f64>,
    pub(crate) recall_share: Option<f64>,
    pub(crate) f1: Option<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct GuardFigures {
    pub(crate) frames: u64,
    pub(crate) accuracy_share: Option<f64>,
    pub(crate) macro_f1: Option<f64>,
    pub(crate) fpr_of_non_slip_share: Option<f64>,
}

impl FrameFigures {
    pub fn new(counts: &FrameCounts) -> Self {
        let (all, guarded) = (&counts.all, &counts.guarded);
        let mut contact = *all;
        contact.confusion[0] = [0; CLASSES];
        Self {
            confusion_frames: all.confusion,
            accuracy_share: all.accuracy(),
            macro_f1: all.macro_f1(),
            classes: (0..CLASSES).map(|class| ClassFigures::new(all, class)).collect(),
            fpr_of_non_slip_share: all.fpr_of_non_slip(),
            fpr_of_all_share: all.fpr_of_all(),
            contact_only_slip: ClassFigures::new(&contact, SLIP as usize),
            guard_band: GuardFigures {
                frames: guarded.frames(),
                accuracy_share: guarded.accuracy(),
                macro_f1: guarded.macro_f1(),
                fpr_of_non_slip_share: guarded.fpr_of_non_slip(),
            },
        }
    }
}

impl ClassFigures {
    fn new(scores: &ClassScores, class: usize) -> Self {
        Self {
            name: CLASS_NAMES[class],
            precision_share: scores.precision(class),
            recall_share: scores.recall(class),
            f1: scores.f1(class),
        }
    }
}

/// The FPR of the frames that do not slip, by where the frames lie.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(crate) struct FalseSlipFigures {
    pub(crate) fpr_before_slip_share: Option<f64>,
    pub(crate) fpr_after_slip_share: Option<f64>,
    pub(crate) fpr_elsewhere_share: Option<f64>,
}

impl FalseSlipFigures {
    pub(crate) fn new(counts: &FrameCounts) -> Self {
        let non_slip = counts.all.confusion[..SLIP as usize].iter().flatten().sum::<u64>() as usize;
        let [before, after, elsewhere] = counts.false_slip.map(|frames| share(frames, non_slip));
        Self { fpr_before_slip_share: before, fpr_after_slip_share: after, fpr_elsewhere_share: elsewhere }
    }
}
