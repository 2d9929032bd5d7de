//! Frame by frame: how many frames got the right class.
//!
//! * *Accuracy*: share of frames whose class is right. *Macro F1*: unweighted mean of the F1 of the three
//!   classes (of those that occur).
//! * *FPR*: frames falsely called slip, as a share of the frames that do not slip (the headline), or of
//!   all frames. The paper does not say which it means; its Table 1 leaves only the former: an FPR of
//!   22.98 % of all frames cannot stand beside an accuracy of 79.41 %.
//! * *Contact only*: precision, recall and F1 of slip among the frames with contact by the label. No
//!   contact is a rule on the pressure sum that label and detector may share, so it is won for free.
//! * *Guard band*: the frames up to 2 beside an onset or end of slip are left out; the encoder's steps and
//!   the clocks cannot place the boundary better.

use serde::Serialize;
use slipsense::params::CLASSES;
use slipsense_recording::score::{ClassScores, SLIP};

use crate::truth::Truth;

/// Frames left out on each side of an onset or end.
pub const GUARD_FRAMES: usize = 2;

/// Names of the classes in output.
pub const CLASS_NAMES: [&str; CLASSES] = ["no_contact", "no_slip", "slip"];

/// Counts of one episode; they add up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCounts {
    /// All frames.
    pub all: ClassScores,
    /// Frames outside the guard bands.
    pub guarded: ClassScores,
}

impl FrameCounts {
    /// Count the frames of an episode judged as `class`.
    pub fn new(truth: &Truth, class: &[u8]) -> Self {
        let all = ClassScores::new(&truth.label, class);
        let mut guarded = all;
        let mut left_out = vec![false; truth.frames()];
        for boundary in truth.slip.iter().flat_map(|&(onset, end)| [onset, end]) {
            let to = (boundary + GUARD_FRAMES).min(truth.frames());
            left_out[boundary.saturating_sub(GUARD_FRAMES)..to].fill(true);
        }
        for f in (0..truth.frames()).filter(|&f| left_out[f]) {
            guarded.confusion[truth.label[f] as usize][class[f] as usize] -= 1;
        }
        Self { all, guarded }
    }

    /// Add another episode's.
    pub fn add(&mut self, other: &Self) {
        self.all.add(&other.all);
        self.guarded.add(&other.guarded);
    }
}

/// Figures of any number of frames. Shares are 0 to 1; null where there is nothing to divide by.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct FrameFigures {
    /// `[truth][decided]`, classes no contact, no slip, slip.
    pub confusion_frames: [[u64; CLASSES]; CLASSES],
    /// Share of frames whose class is right.
    pub accuracy_share: Option<f64>,
    /// Mean F1 of the classes that occur.
    pub macro_f1: Option<f64>,
    /// Of each class.
    pub classes: Vec<ClassFigures>,
    /// False slip frames of the frames that do not slip.
    pub fpr_of_non_slip_share: Option<f64>,
    /// False slip frames of all frames.
    pub fpr_of_all_share: Option<f64>,
    /// Slip among the frames with contact.
    pub contact_only_slip: ClassFigures,
    /// Without the frames beside onsets and ends.
    pub guard_band: GuardFigures,
}

/// Precision, recall and F1 of one class.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ClassFigures {
    /// Name of the class.
    pub name: &'static str,
    /// Of the frames decided so, the share that are.
    pub precision_share: Option<f64>,
    /// Of the frames that are, the share decided so.
    pub recall_share: Option<f64>,
    /// Harmonic mean of the two.
    pub f1: Option<f64>,
}

/// The main figures without the guard bands.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct GuardFigures {
    /// Frames counted.
    pub frames: u64,
    /// As above.
    pub accuracy_share: Option<f64>,
    /// As above.
    pub macro_f1: Option<f64>,
    /// As above.
    pub fpr_of_non_slip_share: Option<f64>,
}

impl FrameFigures {
    /// Figures of the sum of counts.
    pub fn new(counts: &FrameCounts) -> Self {
        let (all, guarded) = (&counts.all, &counts.guarded);
        Self {
            confusion_frames: all.confusion,
            accuracy_share: all.accuracy(),
            macro_f1: all.macro_f1(),
            classes: (0..CLASSES).map(|class| of_class(all, class)).collect(),
            fpr_of_non_slip_share: all.fpr_of_non_slip(),
            fpr_of_all_share: all.fpr_of_all(),
            contact_only_slip: contact_only(all),
            guard_band: GuardFigures {
                frames: guarded.frames(),
                accuracy_share: guarded.accuracy(),
                macro_f1: guarded.macro_f1(),
                fpr_of_non_slip_share: guarded.fpr_of_non_slip(),
            },
        }
    }
}

fn of_class(scores: &ClassScores, class: usize) -> ClassFigures {
    ClassFigures {
        name: CLASS_NAMES[class],
        precision_share: scores.precision(class),
        recall_share: scores.recall(class),
        f1: scores.f1(class),
    }
}

fn contact_only(all: &ClassScores) -> ClassFigures {
    let mut contact = *all;
    contact.confusion[0] = [0; CLASSES];
    of_class(&contact, SLIP as usize)
}
