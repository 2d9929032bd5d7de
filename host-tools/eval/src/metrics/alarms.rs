//! False alarms as events, in all and by cause.
//!
//! False alarms are those of [`slipsense_recording::score`]. Rates are per hour of *exposure*: the time outside the
//! widened slip, in which an alarm can occur. An alarm is attributed to the class of its first frame: of the disturbances
//! active from 150 ms before it, the one of highest precedence ([`crate::truth::DISTURBANCES`]). The exposure is divided
//! by the same rule, so that the classes add up to the whole. Bounds are exact one-sided 95 % bounds of a Poisson rate.

use serde::Serialize;
use slipsense::params::FRAME_RATE_HZ;
use slipsense_recording::score::{Interval, near, score_intervals};

use super::statistics::rate_bound_per_hour;
use crate::truth::{DISTURBANCES, Truth};

/// Alarms and exposure of one episode; they add up.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct AlarmCounts {
    pub(crate) alarms: [u64; DISTURBANCES.len()],
    pub(crate) exposure_frames: [u64; DISTURBANCES.len()],
    /// Alarms in which the contact truly slid, though not by the label; part of `alarms`.
    pub(crate) sliding: u64,
    /// Whether the interface truth was unknown somewhere.
    pub(crate) sliding_unknown: bool,
    pub(crate) interface_alarms: u64,
    /// Exposure outside the widened sliding, frames.
    pub(crate) interface_exposure_frames: u64,
}

impl AlarmCounts {
    /// Count the alarms of an episode; `flag` is non-zero where slip is predicted.
    pub(crate) fn new(truth: &Truth, flag: &[u8]) -> Self {
        let alarms = score_intervals(&truth.slip, flag).false_alarms;
        let mut counts = Self { sliding_unknown: truth.interface.is_none(), ..Self::default() };
        for (f, _) in near(&truth.slip, truth.frames()).iter().enumerate().filter(|(_, near)| !**near) {
            counts.exposure_frames[truth.disturbance[f] as usize] += 1;
        }
        for &(start, _) in &alarms {
            counts.alarms[truth.disturbance[start] as usize] += 1;
        }
        if let Some(interface) = &truth.interface {
            let slides = |&&(from, to): &&Interval| {
                interface.slip.iter().any(|&(start, end)| start < to && from < end)
            };
            counts.sliding = alarms.iter().filter(slides).count() as u64;
            counts.interface_alarms = score_intervals(&interface.slip, flag).false_alarms.len() as u64;
            let near = near(&interface.slip, truth.frames());
            counts.interface_exposure_frames = near.iter().filter(|near| !**near).count() as u64;
        }
        counts
    }

    pub(crate) fn add(&mut self, other: &Self) {
        for class in 0..DISTURBANCES.len() {
            self.alarms[class] += other.alarms[class];
            self.exposure_frames[class] += other.exposure_frames[class];
        }
        self.sliding += other.sliding;
        self.sliding_unknown |= other.sliding_unknown;
        self.interface_alarms += other.interface_alarms;
        self.interface_exposure_frames += other.interface_exposure_frames;
    }

    pub(crate) fn total(&self) -> u64 {
        self.alarms.iter().sum()
    }

    pub(crate) fn hours(&self) -> f64 {
        hours(self.exposure_frames.iter().sum())
    }
}

pub(crate) fn hours(frames: u64) -> f64 {
    frames as f64 / (3600.0 * f64::from(FRAME_RATE_HZ))
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct Rate {
    pub(crate) alarms: u64,
    pub(crate) exposure_hours: f64,
    pub(crate) alarms_per_hour: Option<f64>,
    /// The true rate is below this with 95 % confidence; null without exposure.
    pub(crate) upper_bound_per_hour: Option<f64>,
}

impl Rate {
    pub(crate) fn new(alarms: u64, frames: u64) -> Self {
        let hours = hours(frames);
        Self {
            alarms,
            exposure_hours: hours,
            alarms_per_hour: (frames > 0).then(|| alarms as f64 / hours),
            upper_bound_per_hour: rate_bound_per_hour(alarms, hours),
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct AlarmFigures {
    /// Against the encoder truth, all classes.
    pub(crate) all: Rate,
    /// Of these alarms, those in which the contact truly slid; null where an episode lacks the interface truth.
    pub(crate) of_these_truly_sliding: Option<u64>,
    /// Against the interface truth; null likewise.
    pub(crate) against_interface: Option<Rate>,
    /// By disturbance class, those with exposure, in order of precedence.
    pub(crate) by_disturbance: Vec<ClassRate>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub(crate) struct ClassRate {
    pub(crate) disturbance: &'static str,
    #[serde(flatten)]
    pub(crate) rate: Rate,
}

impl AlarmFigures {
    pub(crate) fn new(counts: &AlarmCounts) -> Self {
        let class_rate = |class: usize| ClassRate {
            disturbance: DISTURBANCES[class],
            rate: Rate::new(counts.alarms[class], counts.exposure_frames[class]),
        };
        let known = !counts.sliding_unknown;
        Self {
            all: Rate::new(counts.total(), counts.exposure_frames.iter().sum()),
            of_these_truly_sliding: known.then_some(counts.sliding),
            against_interface: known
                .then(|| Rate::new(counts.interface_alarms, counts.interface_exposure_frames)),
            by_disturbance: (0..DISTURBANCES.len())
                .filter(|&class| counts.exposure_frames[class] > 0)
                .map(class_rate)
                .collect(),
        }
    }
}
