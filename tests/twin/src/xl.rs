//! What the models of the accelerometers share: which part is fitted, what it plays, what was read of it.

use std::sync::{Arc, Mutex};

use clap::ValueEnum;
use slipsense::sensor::XlSample;
use slipsense_recording::Episode;

use crate::shared::lock;

/// By which fraction an ADXL380's oscillator is faster than nominal; the emulator's ICM-42688-P has none of its own.
pub const OSCILLATOR_ERROR: f64 = 0.7 / 100.0;
/// Both parts' rate, as the firmware sets it.
const NOMINAL_HZ: f64 = 8000.0;

/// An accelerometer that the firmware can be built for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Xl {
    /// ADXL380, a model of ours.
    #[default]
    Adxl380,
    /// ICM-42688-P, the emulator's own model.
    Icm42688,
}

impl Xl {
    /// Samples a second of a part whose oscillator is faster than nominal by this fraction.
    pub fn rate_hz(self, error: f64) -> f64 {
        match self {
            Self::Adxl380 => NOMINAL_HZ * (1.0 + error),
            Self::Icm42688 => NOMINAL_HZ,
        }
    }

    /// The least that an axis of a sample can be. An ICM-42688-P keeps the two below it for what is no sample
    /// (DS-000347, 14.34).
    pub const fn least(self) -> i16 {
        match self {
            Self::Adxl380 => i16::MIN,
            Self::Icm42688 => i16::MIN + 2,
        }
    }
}

/// What was read of a part's FIFO, one batch a transaction, and when it ended, virtual ns.
pub type Readouts = Arc<Mutex<Vec<(u64, Vec<XlSample>)>>>;

/// Adds a batch, if there is one.
pub fn note(readouts: &Readouts, at_ns: u64, batch: Vec<XlSample>) {
    if !batch.is_empty() {
        lock(readouts).push((at_ns, batch));
    }
}

/// Sample `index` of the true acceleration of a part: the episode's, over and over.
pub fn true_sample(episode: Option<&Episode>, sensor: usize, index: usize) -> XlSample {
    let samples = episode.and_then(|episode| episode.xl.get(sensor)).filter(|samples| !samples.is_empty());
    samples.map_or_else(XlSample::default, |samples| samples[index % samples.len()])
}
