//! The frame source until the sensor drivers exist: the tick is real, the data are missing, and say so.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_time::{Instant, Timer};
use slipsense::board::{FrameSource, SensedPart};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::FrameStamp;

const MICROS_PER_SECOND: u64 = 1_000_000;

/// Ticks at the frame rate; no sensor delivers.
pub struct AbsentSensors {
    start: Instant,
    frames: u64,
    ticks: &'static AtomicU32,
}

impl AbsentSensors {
    /// Start the frame clock. `ticks` counts frames for whoever watches over this task, and wraps.
    pub fn start(ticks: &'static AtomicU32) -> Self {
        Self { start: Instant::now(), frames: 0, ticks }
    }
}

impl FrameSource for AbsentSensors {
    const REAL_TIME: bool = true;

    async fn tick(&mut self) -> Option<FrameStamp> {
        self.frames += 1;
        // Counted from the start: 240 Hz is no whole number of microseconds, and a ticker would drift.
        let since_start_us = self.frames * MICROS_PER_SECOND / FRAME_RATE_HZ as u64;
        let tick = Instant::from_micros(self.start.as_micros() + since_start_us);
        Timer::at(tick).await;
        self.ticks.fetch_add(1, Ordering::Relaxed);
        Some(FrameStamp { sequence: self.frames as u32, timestamp_us: tick.as_micros() })
    }

    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]) {
        for part in parts {
            part.piezo_arrived = false;
            part.xl_arrived = false;
        }
    }

    async fn discard(&mut self) {}
}
