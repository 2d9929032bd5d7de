//! What differs from recording to recording of the same array: temperature, age, mains and electrical faults.

use libm::exp;
use serde::Serialize;
use slipsense::params::{COUNT_MAX, FRAME_RATE_HZ, TAXEL_COLS, TAXEL_ROWS, TAXELS};

use super::unit::FilmUnit;
use crate::draw::{Draw, Rng, Span};
use crate::recipe::SECONDS;
use crate::timeline::Event;

/// Age where a recipe names none, months; a unit's loss of gain is given for the whole span.
const AGE_MONTHS: Span = (0.0, 4.0);

#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct Fault {
    pub kind: FaultKind,
    pub start_frame: usize,
    /// First frame after it.
    pub end_frame: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum FaultKind {
    /// A bad connection: a taxel or a few of one row drop to 0 or jump up in some of the frames.
    Flicker {
        row: usize,
        col: usize,
        taxels: usize,
        /// Counts added; `None` for a drop to 0.
        jump_counts: Option<u16>,
        /// One bit per frame, round and round: set where the connection is bad.
        pattern: u64,
    },
    /// A row reads 0.
    RowDropout { row: usize },
    /// The scan does not arrive: the one before it is delivered again.
    MissingFrame,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct FilmSession {
    /// Against the unit's reference, °C.
    pub temperature_c: f64,
    pub age_months: f64,
    /// Noise against the unit's own: supplies and motors nearby. Set, like the shift below, together with the unit's.
    pub noise_factor: f64,
    /// Shift of the idle level of all taxels with temperature and supply, counts.
    pub zero_counts: f64,
    /// Of a grid that strays a little.
    pub mains_hz: f64,
    pub mains_phase: f64,
    /// Its pick-up, share of the unit's worst.
    pub mains_share: f64,
    /// In order of their start, up to the longest recording there is: three recordings of 8 s in four have none.
    #[serde(skip)]
    pub faults: Vec<Fault>,
}

impl FilmSession {
    /// A recording. `noise_factor` scales noise, mains pick-up and how often faults happen.
    pub(crate) fn draw(rng: &mut Rng, noise_factor: f64) -> Self {
        Self {
            temperature_c: rng.between(-8.0, 8.0),
            age_months: rng.uniform(AGE_MONTHS),
            noise_factor: noise_factor * exp(0.15 * rng.normal()).clamp(0.7, 1.5),
            zero_counts: rng.between(-0.2, 0.2),
            mains_hz: [50.0, 60.0][rng.count(0, 1)] + rng.between(-0.1, 0.1),
            mains_phase: rng.phase(),
            mains_share: rng.between(0.0, 1.0),
            faults: faults(rng, 0.03 * noise_factor),
        }
    }

    /// The same recording with an array of another age, if one is named.
    pub(crate) fn aged(self, age_months: Option<f64>) -> Self {
        Self { age_months: age_months.unwrap_or(self.age_months), ..self }
    }

    /// Factor on the conductance of all of `unit`'s taxels.
    pub(crate) fn gain(&self, unit: &FilmUnit) -> f64 {
        (1.0 + unit.per_degree * self.temperature_c) * (1.0 - unit.ageing * self.age_months / AGE_MONTHS.1)
    }

    pub(crate) fn faults(&self, frames: usize) -> impl Iterator<Item = &Fault> {
        self.faults.iter().take_while(move |fault| fault.start_frame < frames)
    }

    pub(crate) fn events(&self, frames: usize) -> Vec<Event> {
        let seconds = |frame: usize| frame as f64 / FRAME_RATE_HZ as f64;
        let event = |fault: &Fault| Event {
            name: "electrical",
            start_s: seconds(fault.start_frame),
            end_s: seconds(fault.end_frame.min(frames)),
        };
        self.faults(frames).map(event).collect()
    }
}

fn faults(rng: &mut Rng, per_s: f64) -> Vec<Fault> {
    let end = (SECONDS.1 * FRAME_RATE_HZ as f64) as usize;
    let mut faults = Vec::new();
    let mut frame = 0;
    loop {
        // No fault in the first frame: a missing frame needs one before it.
        let gap_s = rng.exponential(1e-12) / per_s;
        let start_frame = frame + 1 + (gap_s * FRAME_RATE_HZ as f64).min(end as f64) as usize;
        if start_frame >= end {
            return faults;
        }
        let (kind, (shortest, longest)) = match rng.count(0, 2) {
            0 => (flicker(rng), (2, 60)),
            1 => (FaultKind::RowDropout { row: rng.count(0, TAXEL_ROWS - 1) }, (1, 10)),
            _ => (FaultKind::MissingFrame, (1, 2)),
        };
        let end_frame = start_frame + rng.count(shortest, longest);
        faults.push(Fault { kind, start_frame, end_frame });
        frame = end_frame;
    }
}

fn flicker(rng: &mut Rng) -> FaultKind {
    let taxels = rng.count(1, 4);
    FaultKind::Flicker {
        row: rng.count(0, TAXEL_ROWS - 1),
        col: rng.count(0, TAXEL_COLS - taxels),
        taxels,
        // Above some 500 counts over all, an idle pad reads as touched meanwhile.
        jump_counts: rng.chance(0.5).then(|| rng.log_between(30.0, 600.0).round() as u16),
        // The first frame is always touched.
        pattern: rand::Rng::random::<u64>(rng) | 1,
    }
}

impl Fault {
    /// What becomes of the scan of frame `frame`, after the scan delivered before it.
    pub(crate) fn apply(&self, frame: usize, scan: &mut [u16; TAXELS], before: &[u16; TAXELS]) {
        match self.kind {
            FaultKind::Flicker { row, col, taxels, jump_counts, pattern } => {
                if pattern >> ((frame - self.start_frame) % 64) & 1 == 1 {
                    for value in &mut scan[row * TAXEL_COLS + col..][..taxels] {
                        *value = jump_counts.map_or(0, |jump| (*value + jump).min(COUNT_MAX));
                    }
                }
            }
            FaultKind::RowDropout { row } => scan[row * TAXEL_COLS..][..TAXEL_COLS].fill(0),
            FaultKind::MissingFrame => *scan = *before,
        }
    }
}
