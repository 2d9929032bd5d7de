//! The frame source until the sensor drivers exist: the tick is real, the data are missing, and say so.

use embassy_time::{Instant, Timer};
use slipsense::params::FRAME_RATE_HZ;
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorInput;

const MICROS_PER_SECOND: u64 = 1_000_000;

/// Ticks at the frame rate; no sensor delivers.
pub struct AbsentSensors {
    start: Instant,
    frames: u64,
}

impl AbsentSensors {
    /// What every frame holds: neither taxels nor acceleration.
    pub const INPUTS: [SensorInput<'static>; super::SENSORS] =
        [SensorInput { piezo: None, xl: None }; super::SENSORS];

    /// Start the frame clock.
    pub fn start() -> Self {
        Self { start: Instant::now(), frames: 0 }
    }

    /// Wait for the next tick.
    pub async fn next_frame(&mut self) -> FrameStamp {
        self.frames += 1;
        // Counted from the start: 240 Hz is no whole number of microseconds, and a ticker would drift.
        let since_start_us = self.frames * MICROS_PER_SECOND / FRAME_RATE_HZ as u64;
        let tick = Instant::from_micros(self.start.as_micros() + since_start_us);
        Timer::at(tick).await;
        FrameStamp { sequence: self.frames as u32, timestamp_us: tick.as_micros() }
    }
}
