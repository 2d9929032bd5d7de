//! All fingertips of a board as a [`FrameSource`]: the scan gives the tick, every part is read after it.

use super::array::Array;
use super::track::{XlBatch, XlCounters, XlTrack};
use crate::board::{Accelerometer, FifoSamples, FrameSource, SensedPart, TaxelScan};
use crate::params::MAX_SENSORS;
use crate::pipeline::FrameStamp;
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
    /// Stuck taxels of each array.
    pub stuck_taxels: [TaxelMask; MAX_SENSORS],
}

/// The sensors: one scan of all arrays, and an array and an accelerometer each.
#[derive(Debug)]
pub struct Sensors<T, A> {
    scan: T,
    sensors: heapless::Vec<Sensor<A>, MAX_SENSORS>,
    /// Where FIFOs are read to, one after the other.
    fifo: FifoSamples,
    unwanted: XlBatch,
    now_us: u64,
    lost_scans: u32,
}

/// One fingertip.
#[derive(Debug)]
pub struct Sensor<A> {
    /// Its array.
    pub array: Array,
    /// Its accelerometer.
    pub xl: XlTrack<A>,
}

impl<T: TaxelScan, A: Accelerometer> Sensors<T, A> {
    /// The sensors in the order in which the scan converts their arrays.
    pub const fn new(scan: T, sensors: heapless::Vec<Sensor<A>, MAX_SENSORS>) -> Self {
        Self { scan, sensors, fifo: FifoSamples::new(), unwanted: XlBatch::new(), now_us: 0, lost_scans: 0 }
    }

    /// The fingertips, to change a mounting or a mask.
    pub fn sensors(&mut self) -> &mut [Sensor<A>] {
        &mut self.sensors
    }

    /// The scan.
    pub const fn scan(&mut self) -> &mut T {
        &mut self.scan
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
}

impl<T: TaxelScan, A: Accelerometer> FrameSource for Sensors<T, A> {
    const REAL_TIME: bool = true;

    async fn tick(&mut self) -> Option<FrameStamp> {
        let stamp = self.scan.tick().await;
        self.now_us = stamp.timestamp_us;
        Some(stamp)
    }

    /// Accelerometers first, because their FIFOs go on filling; the scan's codes stay for a whole frame.
    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]) {
        for (sensor, part) in self.sensors.iter_mut().zip(parts.iter_mut()) {
            part.xl_arrived = sensor.xl.tick(self.now_us, &mut self.fifo, &mut part.xl).await;
            part.xl_end = sensor.xl.xl_end();
            part.piezo_arrived = false;
        }
        let arrays = self.sensors.len();
        if let Some(codes) = self.scan.codes() {
            for (index, (sensor, part)) in self.sensors.iter_mut().zip(parts.iter_mut()).enumerate() {
                part.piezo_arrived = sensor.array.read(codes, index, arrays, &mut part.piezo);
            }
        }
        if self.scan.codes().is_none() || !self.scan.is_untouched() {
            self.lost_scans = self.lost_scans.saturating_add(1);
            parts.iter_mut().for_each(|part| part.piezo_arrived = false);
        }
    }

    /// The FIFOs are emptied all the same, so that their samples stay counted and none overflows.
    async fn discard(&mut self) {
        for sensor in &mut self.sensors {
            sensor.xl.tick(self.now_us, &mut self.fifo, &mut self.unwanted).await;
            sensor.xl.discard();
        }
    }
}
