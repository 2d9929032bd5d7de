//! Calibrating an array while it senses: the services begin, the sensors measure, the services store, the sensors apply.
//!
//! ```text
//! Commissioning ──(job, bench)──> Sensors, frame by frame ──(job, bench)──> Commissioning ──> flash
//! ```
//!
//! The bench, on which sums and tables are, is handed over, never copied: whoever has it may write.

use core::borrow::BorrowMut;
use core::cell::Cell;
use core::fmt;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embedded_storage_async::nor_flash::NorFlash;

use super::sensor_link::{Bench, Job, SensorLink};
use crate::calibration::{BLOCK_FRAMES, Progress, Refusal, Request, SECONDS_MAX, State, Summary, What};
use crate::params::MAX_SENSORS;
use crate::settings::{Scratch, SettingsStore, StoreError};

/// Why a measurement did not become a calibration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the text says it")]
pub enum Failure {
    Refused(Refusal),
    NotStored(StoreError),
    Gain,
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Refused(why) => write!(f, "{why}"),
            Self::NotStored(why) => write!(f, "{why}"),
            Self::Gain => f.write_str("a gain would be 0, or 2 and more"),
        }
    }
}

/// The services' end.
pub struct Commissioning<'l, M: RawMutex> {
    link: &'l SensorLink<'l, M>,
    bench: Option<&'l mut Bench>,
    /// What is being done, until [`finish`](Self::finish).
    request: Option<Request>,
    /// Connector of each array in use, under whose number its calibration is stored.
    connectors: heapless::Vec<usize, MAX_SENSORS>,
    progress: Progress,
    summaries: [Summary; MAX_SENSORS],
}

impl<'l, M: RawMutex> Commissioning<'l, M> {
    /// For arrays that are calibrated as `summaries` say; `connectors`: where each is plugged in.
    pub fn new(
        link: &'l SensorLink<'l, M>,
        bench: &'l mut Bench,
        connectors: heapless::Vec<usize, MAX_SENSORS>,
        summaries: [Summary; MAX_SENSORS],
    ) -> Self {
        let progress = Progress::default();
        Self { link, bench: Some(bench), request: None, connectors, progress, summaries }
    }

    /// How far the last measurement is.
    pub fn progress(&self) -> Progress {
        let measured = self.link.measured.lock(Cell::get) as u16;
        match self.progress.state {
            State::Measuring => Progress { frames: measured, ..self.progress },
            _ => self.progress,
        }
    }

    /// How each array is calibrated.
    pub const fn summaries(&self) -> &[Summary; MAX_SENSORS] {
        &self.summaries
    }

    /// Take a request up. It is done when [`is_ready`](Self::is_ready), then [`finish`](Self::finish): a measurement
    /// after its time, all else at once.
    pub fn begin(&mut self, request: Request) -> Result<(), &'static str> {
        let sensor = usize::from(request.sensor);
        let busy = self.is_ready();
        let Some(summary) = self.summaries.get(sensor).filter(|_| sensor < self.connectors.len()) else {
            return Err("no such sensor");
        };
        match request.what {
            What::Measure(seconds) if !(1..=SECONDS_MAX).contains(&u32::from(seconds)) => {
                return Err("1 to 60 seconds");
            }
            What::Scale(_) if summary.version == 0 => return Err("measure the untouched pad first"),
            _ => {}
        }
        let Some(bench) = self.bench.take_if(|_| !busy) else { return Err("a calibration is not done yet") };
        self.progress = Progress { sensor: request.sensor, state: State::Measuring, ..Progress::default() };
        match request.what {
            What::Measure(seconds) => {
                bench.measurement.clear();
                let frames = u32::from(seconds) * BLOCK_FRAMES;
                self.progress.wanted = frames as u16;
                self.link.hand_over(Job::Measure { sensor, frames }, bench);
            }
            What::Forget | What::Scale(_) => self.bench = Some(bench),
        }
        self.request = Some(request);
        Ok(())
    }

    /// Is there something to [`finish`](Self::finish)?
    pub fn is_ready(&mut self) -> bool {
        if let Some((_, bench)) = self.link.done.lock(Cell::take) {
            self.bench = Some(bench);
        }
        self.request.is_some() && self.bench.is_some()
    }

    /// Make the new calibration, store it, apply it. `None`: there was nothing to do.
    pub async fn finish<F: NorFlash, B: BorrowMut<Scratch>>(
        &mut self,
        store: &mut SettingsStore<F, B>,
    ) -> Option<(u8, Result<Summary, Failure>)> {
        let request = self.request?;
        let bench = self.bench.take()?;
        self.request = None;
        let sensor = usize::from(request.sensor);
        let connector = self.connectors.get(sensor).copied().unwrap_or(sensor);
        // Gains are kept over a new measurement.
        store.load_calibration(connector, &mut bench.calibration).await;
        let made = match request.what {
            What::Measure(_) => {
                self.progress.frames = bench.measurement.frames() as u16;
                let mounting = self.link.mountings().get(sensor).copied().unwrap_or_default();
                bench.measurement.evaluate(&mounting.pad(), &mut bench.calibration).map_err(Failure::Refused)
            }
            What::Forget => {
                bench.calibration.set_nominal();
                Ok(())
            }
            What::Scale(factor) if bench.calibration.scale(factor) => Ok(()),
            What::Scale(_) => Err(Failure::Gain),
        };
        let stored = match made {
            Ok(()) => {
                store.store_calibration(connector, &bench.calibration).await.map_err(Failure::NotStored)
            }
            why => why,
        };
        (self.progress.state, self.progress.at) = match stored {
            Ok(()) => (State::Done, (0, 0)),
            Err(Failure::Refused(Refusal::Touched { row, col })) => (State::Touched, (row, col)),
            Err(Failure::Refused(Refusal::Faulty { row, col, .. })) => (State::Faulty, (row, col)),
            Err(Failure::Refused(Refusal::TooShort)) => (State::TooShort, (0, 0)),
            Err(Failure::NotStored(_)) => (State::NotStored, (0, 0)),
            Err(Failure::Gain) => (State::Gain, (0, 0)),
        };
        if stored.is_ok() {
            let summary = bench.calibration.summary();
            if let Some(own) = self.summaries.get_mut(sensor) {
                *own = summary;
            }
            let gains_only = matches!(request.what, What::Scale(_));
            self.link.hand_over(Job::Install { sensor, gains_only }, bench);
            return Some((request.sensor, Ok(summary)));
        }
        self.bench = Some(bench);
        Some((request.sensor, stored.map(|()| Summary::default())))
    }
}
