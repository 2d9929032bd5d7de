//! All fingertips of a board as a [`FrameSource`]: the scan gives the tick, every part is read after it.

use core::cell::Cell;

use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::array::{Array, Mounting};
use super::commissioning::{Bench, Job};
use super::xl_monitor::{XlBatch, XlCounters, XlMonitor};
use crate::board::{Accelerometer, FifoSamples, FrameSource, TaxelScan};
use crate::params::{FRAME_RATE_HZ, MAX_SENSORS};
use crate::pipeline::FrameStamp;
use crate::sensor::SensorReadings;
use crate::sensor::TaxelMask;

/// What there is to say about the sensors beside their readings. Entries beyond the sensors in use are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorReport {
    /// Accelerometers.
    pub xl: [XlCounters; MAX_SENSORS],
    /// Samples of each accelerometer, at its native rate, that nobody could read.
    pub xl_lost: [u64; MAX_SENSORS],
    /// Native rate of each accelerometer by the board's clock, 1/1000 Hz.
    pub xl_rate_mhz: [u64; MAX_SENSORS],
    /// Frames whose scan was lost.
    pub lost_scans: u32,
    /// Which arrays are dead.
    pub dead_arrays: [bool; MAX_SENSORS],
    /// Faulty and stuck taxels of each array.
    pub stuck_taxels: [TaxelMask; MAX_SENSORS],
}

/// What other tasks tell the sensors and hear from them.
pub struct SensorLink<'l, M: RawMutex> {
    report: Mutex<M, Cell<Option<SensorReport>>>,
    mountings: Mutex<M, Cell<[Mounting; MAX_SENSORS]>>,
    /// To the sensors, and back when it is done.
    job: Mutex<M, Cell<Option<(Job, &'l mut Bench)>>>,
    done: Mutex<M, Cell<Option<(Job, &'l mut Bench)>>>,
    measured: Mutex<M, Cell<u32>>,
}

impl<'l, M: RawMutex> SensorLink<'l, M> {
    /// Plain mountings, no report yet.
    pub const fn new() -> Self {
        const PLAIN: Mounting = Mounting { rows_flipped: false, cols_flipped: false };
        Self {
            report: Mutex::new(Cell::new(None)),
            mountings: Mutex::new(Cell::new([PLAIN; MAX_SENSORS])),
            job: Mutex::new(Cell::new(None)),
            done: Mutex::new(Cell::new(None)),
            measured: Mutex::new(Cell::new(0)),
        }
    }

    /// Let the sensors do this with the bench, which nobody else has; [`take_back`](Self::take_back) it then.
    pub(super) fn hand_over(&self, job: Job, bench: &'l mut Bench) {
        self.job.lock(|cell| cell.set(Some((job, bench))));
    }

    /// What the sensors are done with.
    pub(super) fn take_back(&self) -> Option<(Job, &'l mut Bench)> {
        self.done.lock(Cell::take)
    }

    /// Frames of the measurement that goes on, or went on last.
    pub(super) fn measured(&self) -> u32 {
        self.measured.lock(Cell::get)
    }

    /// How the arrays are mounted.
    pub(super) fn mountings(&self) -> [Mounting; MAX_SENSORS] {
        self.mountings.lock(Cell::get)
    }

    /// From the next frame on the arrays are mounted so.
    pub fn mount(&self, mountings: [Mounting; MAX_SENSORS]) {
        self.mountings.lock(|own| own.set(mountings));
    }

    /// The last report, of which there is one a second; `None` in the first second.
    pub fn report(&self) -> Option<SensorReport> {
        self.report.lock(Cell::get)
    }
}

impl<M: RawMutex> Default for SensorLink<'_, M> {
    fn default() -> Self {
        Self::new()
    }
}

/// The sensors: one scan of all arrays, and an array and an accelerometer each.
pub struct Sensors<'l, M: RawMutex, T, A> {
    scan: T,
    link: &'l SensorLink<'l, M>,
    frames_until_report: u32,
    sensors: heapless::Vec<Sensor<'l, A>, MAX_SENSORS>,
    work: Option<(Job, &'l mut Bench)>,
    /// Where FIFOs are read to, one after the other.
    fifo: FifoSamples,
    unwanted: XlBatch,
    now_us: u64,
    lost_scans: u32,
}

/// One fingertip.
#[derive(Debug)]
pub struct Sensor<'l, A> {
    /// Its array.
    pub array: Array<'l>,
    /// Its accelerometer.
    pub xl: XlMonitor<A>,
}

impl<'l, M: RawMutex, T: TaxelScan, A: Accelerometer> Sensors<'l, M, T, A> {
    /// The sensors in the order in which the scan converts their arrays.
    pub const fn new(
        scan: T,
        sensors: heapless::Vec<Sensor<'l, A>, MAX_SENSORS>,
        link: &'l SensorLink<'l, M>,
    ) -> Self {
        Self {
            scan,
            link,
            frames_until_report: FRAME_RATE_HZ,
            sensors,
            work: None,
            fifo: FifoSamples::new(),
            unwanted: XlBatch::new(),
            now_us: 0,
            lost_scans: 0,
        }
    }

    /// What went wrong so far.
    pub fn report(&self) -> SensorReport {
        let mut report = SensorReport { lost_scans: self.lost_scans, ..SensorReport::default() };
        for (i, Sensor { array, xl }) in self.sensors.iter().enumerate().take(MAX_SENSORS) {
            report.xl[i] = xl.counters();
            report.xl_lost[i] = xl.count().lost();
            report.xl_rate_mhz[i] = xl.count().rate_mhz();
            report.dead_arrays[i] = array.is_dead();
            report.stuck_taxels[i] = *array.stuck();
        }
        report
    }

    /// A frame's part of what the services have to do with an array's calibration.
    #[inline(never)]
    fn calibrate(&mut self) {
        let Some((job, bench)) = self.work.take().or_else(|| self.link.job.lock(Cell::take)) else { return };
        match job {
            Job::Measure { sensor, frames } => {
                if let Some(codes) = self.scan.codes() {
                    bench.measurement.add(codes, sensor, self.sensors.len());
                }
                self.link.measured.lock(|cell| cell.set(bench.measurement.frames()));
                if frames > 1 {
                    // Frames whose scan is lost count too: a scan that never runs must not keep the bench.
                    self.work = Some((Job::Measure { sensor, frames: frames - 1 }, bench));
                    return;
                }
            }
            Job::Install { sensor, gains_only } => {
                if let Some(Sensor { array, .. }) = self.sensors.get_mut(sensor) {
                    array.calibrate(&bench.calibration, gains_only);
                }
            }
        }
        self.link.done.lock(|cell| cell.set(Some((job, bench))));
    }
}

impl<M: RawMutex, T: TaxelScan, A: Accelerometer> FrameSource for Sensors<'_, M, T, A> {
    const REAL_TIME: bool = true;

    async fn tick(&mut self) -> Option<FrameStamp> {
        for (Sensor { array, .. }, mounting) in self.sensors.iter_mut().zip(self.link.mountings()) {
            if array.mounting() != mounting {
                array.mount(mounting);
            }
        }
        self.frames_until_report -= 1;
        if self.frames_until_report == 0 {
            self.frames_until_report = FRAME_RATE_HZ;
            self.link.report.lock(|last| last.set(Some(self.report())));
        }
        let stamp = self.scan.tick().await;
        self.now_us = stamp.timestamp_us;
        Some(stamp)
    }

    /// Accelerometers first, because their FIFOs go on filling; the scan's codes stay for a whole frame.
    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        for (sensor, part) in self.sensors.iter_mut().zip(parts.iter_mut()) {
            part.xl_arrived = sensor.xl.tick(self.now_us, &mut self.fifo, &mut part.xl).await;
            part.xl_end = sensor.xl.xl_end();
            part.piezo_arrived = false;
        }
        let arrays = self.sensors.len();
        if let Some(codes) = self.scan.codes() {
            for (index, (sensor, part)) in self.sensors.iter_mut().zip(parts.iter_mut()).enumerate() {
                part.piezo_arrived = sensor.array.read(codes, index, arrays, &mut part.piezo);
                part.stuck = *sensor.array.stuck();
            }
        }
        self.calibrate();
        if self.scan.codes().is_none() || !self.scan.is_untouched() {
            self.lost_scans = self.lost_scans.saturating_add(1);
            parts.iter_mut().for_each(|part| part.piezo_arrived = false);
        }
    }

    /// The FIFOs are emptied all the same, so that their samples stay counted and none overflows; the next frame's index
    /// shows the gap.
    async fn discard(&mut self) {
        for sensor in &mut self.sensors {
            sensor.xl.tick(self.now_us, &mut self.fifo, &mut self.unwanted).await;
        }
    }
}
