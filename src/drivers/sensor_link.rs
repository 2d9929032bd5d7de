//! What other tasks exchange with the sensors: mountings, reports, and the bench of a calibration.

use core::cell::Cell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::array::Mounting;
use super::xl_monitor::XlCounters;
use crate::calibration::{Calibration, Measurement};
use crate::params::MAX_SENSORS;
use crate::sensor::TaxelMask;

/// What there is to say about the sensors beside their readings. Entries beyond the sensors in use are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct SensorReport {
    pub xl: [XlCounters; MAX_SENSORS],
    /// Samples of each accelerometer, at its native rate, that nobody could read.
    pub xl_lost: [u64; MAX_SENSORS],
    /// Native rate of each accelerometer by the board's clock, 1/1000 Hz.
    pub xl_rate_mhz: [u64; MAX_SENSORS],
    /// Frames whose scan was lost.
    pub lost_scans: u32,
    pub dead_arrays: [bool; MAX_SENSORS],
    /// Faulty and stuck taxels of each array.
    pub stuck_taxels: [TaxelMask; MAX_SENSORS],
}

/// What other tasks tell the sensors and hear from them.
pub struct SensorLink<'l, M: RawMutex> {
    pub(super) report: Mutex<M, Cell<Option<SensorReport>>>,
    mountings: Mutex<M, Cell<[Mounting; MAX_SENSORS]>>,
    /// Until the sensors take them over.
    pub(super) switched_off: Mutex<M, Cell<Option<[TaxelMask; MAX_SENSORS]>>>,
    /// To the sensors, and back when it is done.
    pub(super) job: Mutex<M, Cell<Option<(Job, &'l mut Bench)>>>,
    pub(super) done: Mutex<M, Cell<Option<(Job, &'l mut Bench)>>>,
    /// Frames of the measurement that goes on, or went on last.
    pub(super) measured: Mutex<M, Cell<u32>>,
}

impl<'l, M: RawMutex> SensorLink<'l, M> {
    /// Plain mountings, no report yet.
    pub const fn new() -> Self {
        const PLAIN: Mounting = Mounting { rows_flipped: false, cols_flipped: false };
        Self {
            report: Mutex::new(Cell::new(None)),
            mountings: Mutex::new(Cell::new([PLAIN; MAX_SENSORS])),
            switched_off: Mutex::new(Cell::new(None)),
            job: Mutex::new(Cell::new(None)),
            done: Mutex::new(Cell::new(None)),
            measured: Mutex::new(Cell::new(0)),
        }
    }

    /// Let the sensors do this with the bench, which nobody else has; `done` gives it back.
    pub(super) fn hand_over(&self, job: Job, bench: &'l mut Bench) {
        self.job.lock(|cell| cell.set(Some((job, bench))));
    }

    /// How the arrays are mounted.
    pub(super) fn mountings(&self) -> [Mounting; MAX_SENSORS] {
        self.mountings.lock(Cell::get)
    }

    /// From the next frame on the arrays are mounted so.
    pub fn mount(&self, mountings: [Mounting; MAX_SENSORS]) {
        self.mountings.lock(|own| own.set(mountings));
    }

    /// From the next frame on these taxels of the pads are no touch.
    pub fn switch_off(&self, taxels: [TaxelMask; MAX_SENSORS]) {
        self.switched_off.lock(|cell| cell.set(Some(taxels)));
    }

    /// The last report, of which there is one a second; `None` in the first second.
    pub fn report(&self) -> Option<SensorReport> {
        self.report.lock(Cell::get)
    }
}

/// Where an array is measured and its new calibration made. Zeros at first.
pub struct Bench {
    pub(super) measurement: Measurement,
    pub(super) calibration: Calibration,
}

impl Bench {
    /// Nothing on it.
    pub const fn new() -> Self {
        Self { measurement: Measurement::new(), calibration: Calibration::zeroed() }
    }
}

/// What the sensors do with the bench.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Job {
    /// Measure an array for so many frames more.
    Measure { sensor: usize, frames: u32 },
    /// Trim an array so from now on.
    Install { sensor: usize, gains_only: bool },
}
