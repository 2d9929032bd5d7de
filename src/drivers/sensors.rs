//! All fingertips of a board as a [`FrameSource`]: the scan gives the tick; accelerometers are read just before it, so
//! that the frame does not wait for their bus, arrays after it.

use core::cell::Cell;

use embassy_sync::blocking_mutex::raw::RawMutex;

use super::array::Array;
use super::sensor_link::{Bench, Job, SensorLink, SensorReport};
use super::xl_monitor::{XlBatch, XlMonitor};
use crate::board::{Accelerometer, FifoSamples, FrameSource, TaxelScan};
use crate::params::{FRAME_PERIOD_US, FRAME_RATE_HZ, MAX_SENSORS};
use crate::pipeline::FrameStamp;
use crate::sensor::SensorReadings;

/// The sensors: one scan of all arrays, and an array and an accelerometer each.
pub struct Sensors<'l, M: RawMutex, T, A> {
    scan: T,
    link: &'l SensorLink<'l, M>,
    frames_until_report: u32,
    sensors: heapless::Vec<Sensor<'l, A>, MAX_SENSORS>,
    work: Option<(Job, &'l mut Bench)>,
    /// Where FIFOs are read to, one after the other.
    fifo: FifoSamples,
    /// Did the accelerometers answer for the next frame?
    arrived: [bool; MAX_SENSORS],
    now_us: u64,
    lost_scans: u32,
}

/// One fingertip.
#[derive(Debug)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Sensor<'l, A> {
    pub array: Array<'l>,
    pub xl: XlMonitor<A>,
    /// The samples of its next frame.
    pub batch: &'l mut XlBatch,
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
            arrived: [false; MAX_SENSORS],
            now_us: 0,
            lost_scans: 0,
        }
    }

    /// What went wrong so far.
    pub fn report(&self) -> SensorReport {
        let mut report = SensorReport { lost_scans: self.lost_scans, ..SensorReport::default() };
        for (i, Sensor { array, xl, .. }) in self.sensors.iter().enumerate().take(MAX_SENSORS) {
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
        if let Some(taxels) = self.link.switched_off.lock(Cell::take) {
            for (Sensor { array, .. }, off) in self.sensors.iter_mut().zip(taxels) {
                array.switch_off(off);
            }
        }
        self.frames_until_report -= 1;
        if self.frames_until_report == 0 {
            self.frames_until_report = FRAME_RATE_HZ;
            self.link.report.lock(|last| last.set(Some(self.report())));
        }
        // Also for a frame that the queue has no room for: samples stay counted, and no FIFO overflows.
        let lead_us = A::PART.read_us * self.sensors.len() as u64;
        self.scan.wait_before(lead_us).await;
        let read_us = self.now_us + FRAME_PERIOD_US.saturating_sub(lead_us);
        for (Sensor { xl, batch, .. }, arrived) in self.sensors.iter_mut().zip(&mut self.arrived) {
            *arrived = xl.tick(read_us, &mut self.fifo, batch).await;
        }
        let stamp = self.scan.tick().await;
        self.now_us = stamp.timestamp_us;
        Some(stamp)
    }

    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        for ((sensor, &arrived), part) in self.sensors.iter().zip(&self.arrived).zip(parts.iter_mut()) {
            (part.xl_arrived, part.xl_end) = (arrived, sensor.xl.xl_end());
            part.xl.clear();
            _ = part.xl.extend_from_slice(sensor.batch);
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
}
