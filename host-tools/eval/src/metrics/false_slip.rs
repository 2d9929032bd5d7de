//! Where the frames falsely called slip lie: up to 50 ms before an onset, where a flag is early; up to 50 ms after an
//! end, where it lasts; or elsewhere, where nothing explains it. The three add up to the FPR of [`super::frames`].

use serde::Serialize;
use slipsense_recording::score::{MARGIN_FRAMES, SLIP};

use super::statistics::share;
use crate::grid::Grid;
use crate::results::DetectorResults;
use crate::table::percent;
use crate::truth::Truth;

/// Counts of one episode; they add up. Frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FalseSlipCounts {
    /// Do not slip by the label.
    pub non_slip: usize,
    /// Of these falsely called slip, up to 50 ms before an onset.
    pub before: usize,
    /// ... up to 50 ms after an end, and not before the next onset.
    pub after: usize,
    /// ... in neither.
    pub elsewhere: usize,
}

impl FalseSlipCounts {
    /// Count the frames of an episode judged as `class`.
    pub fn new(truth: &Truth, class: &[u8]) -> Self {
        let frames = truth.frames();
        let (mut before, mut after) = (vec![false; frames], vec![false; frames]);
        for &(onset, end) in &truth.slip {
            before[onset.saturating_sub(MARGIN_FRAMES)..onset].fill(true);
            after[end..(end + MARGIN_FRAMES).min(frames)].fill(true);
        }
        let mut counts = Self::default();
        for f in (0..frames).filter(|&f| truth.label[f] != SLIP) {
            counts.non_slip += 1;
            if class[f] == SLIP {
                *match (before[f], after[f]) {
                    (true, _) => &mut counts.before,
                    (false, true) => &mut counts.after,
                    (false, false) => &mut counts.elsewhere,
                } += 1;
            }
        }
        counts
    }

    /// Add another episode's.
    pub fn add(&mut self, other: &Self) {
        self.non_slip += other.non_slip;
        self.before += other.before;
        self.after += other.after;
        self.elsewhere += other.elsewhere;
    }
}

/// Frames falsely called slip as shares of the frames that do not slip, 0 to 1; null where there are none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct FalseSlipFigures {
    /// Up to 50 ms before an onset.
    pub fpr_before_slip_share: Option<f64>,
    /// Up to 50 ms after an end.
    pub fpr_after_slip_share: Option<f64>,
    /// In neither.
    pub fpr_elsewhere_share: Option<f64>,
}

impl FalseSlipFigures {
    /// Figures of the sum of counts.
    pub fn new(counts: &FalseSlipCounts) -> Self {
        let of = |frames| share(frames, counts.non_slip);
        Self {
            fpr_before_slip_share: of(counts.before),
            fpr_after_slip_share: of(counts.after),
            fpr_elsewhere_share: of(counts.elsewhere),
        }
    }
}

/// The table for terminal and report, of the inputs with slips that `has_slips` names; `kind` says what data it is.
pub(crate) fn grid(
    detectors: &[DetectorResults],
    has_slips: impl Fn(&str) -> bool,
    kind: &str,
) -> Option<Grid> {
    let mut rows = Vec::new();
    for detector in detectors {
        for of in detector.inputs.iter().filter(|of| has_slips(&of.input)) {
            let (all, parts) = (of.figures.frame.fpr_of_non_slip_share, &of.figures.false_slip);
            let parts = [parts.fpr_before_slip_share, parts.fpr_after_slip_share, parts.fpr_elsewhere_share];
            let numbers = [all].into_iter().chain(parts).map(percent);
            rows.push([detector.name.clone(), of.input.clone()].into_iter().chain(numbers).collect());
        }
    }
    (!rows.is_empty()).then(|| Grid {
        title: format!("false slip frames by where they lie ({kind})"),
        header: vec!["detector", "input", "FPR %", "before slip %", "after slip %", "elsewhere %"],
        word_columns: 2,
        rows,
        note:
            "of the frames that do not slip; before and after: up to 50 ms from an onset or end by the label"
                .to_owned(),
    })
}
