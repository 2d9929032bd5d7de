//! Faults of sensors, bus, settings and time, and which of them are active at a frame.

use std::ops::Range;

use slipsense::fixed::Logit;
use slipsense::net::format::OperatingPoint;
use slipsense::params::{COUNT_MAX, MAX_SENSORS, TAXEL_COLS, XL_BATCH_MAX};
use slipsense::sensor::{PiezoFrame, SensorReadings, TaxelMask};
use slipsense::tasks::RuntimeConfig;
use slipsense_can_sim::controller::Disturbance;

use self::Effect::{AllSensors, Bus, Sensor, Setting, Skip, SlowRead};
use super::world::healthy;

/// A reading that ends after the next tick.
const SLOW_NS: u64 = 6_000_000;

const MASK: TaxelMask = TaxelMask::NONE.with(3, 14).with(20, 9);
const POINT: OperatingPoint = OperatingPoint { threshold: Logit::from_bits(77), k: 2, n: 5 };

/// What a fault does. The number beside the readings: frames since it started.
#[derive(Clone, Copy)]
pub enum Effect {
    Sensor(fn(&mut SensorReadings, u32)),
    AllSensors(fn(&mut SensorReadings, u32)),
    /// Samples that the accelerometer's count skips at the start.
    Skip(u32),
    Bus(fn(Range<u64>) -> Disturbance),
    Setting(fn(&mut RuntimeConfig, usize)),
    SlowRead,
}

/// Put another count, of its index and itself, in the place of every one.
pub fn counts(part: &mut SensorReadings, change: impl Fn(usize, u16) -> u16) {
    let mut counts = *part.piezo.counts();
    counts.iter_mut().enumerate().for_each(|(index, count)| *count = change(index, *count));
    part.piezo = PiezoFrame::from_scan(counts);
}

fn silent(part: &mut SensorReadings, _: u32) {
    (part.piezo_arrived, part.xl_arrived) = (false, false);
}

fn both_ends(part: &mut SensorReadings, _: u32) {
    part.xl.iter_mut().enumerate().for_each(|(i, s)| *s = [[i16::MIN, i16::MAX][i % 2]; 3]);
}

fn full_column(part: &mut SensorReadings, _: u32) {
    counts(part, |i, n| if i % TAXEL_COLS == 20 { COUNT_MAX } else { n });
}

fn noisy(part: &mut SensorReadings, age: u32) {
    counts(part, |i, n| n ^ ((i as u32 + age).wrapping_mul(2_654_435_761) >> 22) as u16);
}

fn locked_and_turned(config: &mut RuntimeConfig, sensor: usize) {
    (config.locked, config.mountings[sensor]) = (true, (true, false));
}

pub fn plain() -> Disturbance {
    Disturbance::default()
}

pub const FAULTS: [(&str, Effect); 32] = [
    ("array silent", Sensor(|part, _| part.piezo_arrived = false)),
    ("accelerometer silent", Sensor(|part, _| part.xl_arrived = false)),
    ("sensor silent", Sensor(silent)),
    ("all sensors silent", AllSensors(silent)),
    ("accelerometer frozen", Sensor(|part, _| part.xl.fill([7, -5, 2_000]))),
    ("sample clipped", Sensor(|part, _| part.xl[5][1] = i16::MAX)),
    ("samples at both ends", Sensor(both_ends)),
    ("no samples", Sensor(|part, _| part.xl.clear())),
    ("samples missing at the end", Sensor(|part, _| part.xl.truncate(20))),
    ("as many samples as fit", Sensor(|part, _| part.xl.resize(XL_BATCH_MAX, [3, 1, 4]).unwrap())),
    ("FIFO overrun", Skip(7)),
    ("samples of a second missing", Skip(8_000)),
    ("accelerometer restarted", Skip(0x8000_0000)),
    ("array shorted", Sensor(|part, _| counts(part, |_, _| 0))),
    ("array at full scale", Sensor(|part, _| counts(part, |_, _| COUNT_MAX))),
    ("row open", Sensor(|part, _| counts(part, |i, n| if i / TAXEL_COLS == 9 { 0 } else { n }))),
    ("column at full scale", Sensor(full_column)),
    ("taxels noisy", Sensor(noisy)),
    ("taxel found stuck", Sensor(|part, _| part.stuck = TaxelMask::NONE.with(10, 20))),
    ("every 10th frame destroyed", Bus(|_| Disturbance { error_every: 10, ..plain() })),
    ("every 3rd frame destroyed", Bus(|_| Disturbance { error_every: 3, ..plain() })),
    ("bus half full", Bus(|_| Disturbance { foreign_load_percent: 50, ..plain() })),
    ("bus full", Bus(|_| Disturbance { foreign_load_percent: 100, ..plain() })),
    ("no acknowledgement", Bus(|ns| Disturbance { silent_ns: ns, ..plain() })),
    ("bus held dominant", Bus(|ns| Disturbance { dominant_ns: ns, ..plain() })),
    ("taxels masked", Setting(|config, sensor| config.masks[sensor] = MASK)),
    ("operating point", Setting(|config, _| config.point = Some(POINT))),
    ("another model expected", Setting(|config, _| config.expected_model = Some([1; 2]))),
    ("raw messages compressed", Setting(|config, _| config.compress_raw = true)),
    ("raw messages of one frame in four", Setting(|config, _| config.raw_every = 4)),
    ("locked, array turned", Setting(locked_and_turned)),
    ("slow reading", SlowRead),
];

pub struct Fault {
    /// Place in [`FAULTS`].
    pub kind: usize,
    pub sensor: usize,
    pub frames: Range<u32>,
}

/// The faults that are still to come, in order, those that are active, and the samples skipped so far.
pub struct Plan<'a> {
    coming: std::slice::Iter<'a, Fault>,
    active: Vec<&'a Fault>,
    skipped: [u32; MAX_SENSORS],
    first_sample: u32,
}

impl<'a> Plan<'a> {
    /// `first_sample`: how many samples the accelerometers have counted before the first frame.
    pub fn new(faults: &'a [Fault], first_sample: u32) -> Self {
        Self { coming: faults.iter(), active: Vec::new(), skipped: [0; MAX_SENSORS], first_sample }
    }

    /// What is active at a frame. Frames must come in order; the same one may come again.
    pub fn at(&mut self, frame: u32) -> impl Iterator<Item = (&'a Fault, Effect)> {
        while let Some(fault) = self.coming.as_slice().first().filter(|fault| fault.frames.start <= frame) {
            self.coming.next();
            self.active.push(fault);
            if let Skip(samples) = FAULTS[fault.kind].1 {
                let skipped = &mut self.skipped[fault.sensor];
                *skipped = skipped.wrapping_add(samples);
            }
        }
        self.active.retain(|fault| fault.frames.contains(&frame));
        self.active.iter().map(|&fault| (fault, FAULTS[fault.kind].1))
    }

    pub fn readings(&mut self, frame: u32, parts: &mut [SensorReadings; MAX_SENSORS]) {
        healthy(frame, parts);
        parts.iter_mut().for_each(|part| part.stuck = TaxelMask::NONE);
        for (fault, effect) in self.at(frame) {
            let age = frame - fault.frames.start;
            match effect {
                Sensor(change) => change(&mut parts[fault.sensor], age),
                AllSensors(change) => parts.iter_mut().for_each(|part| change(part, age)),
                _ => {}
            }
        }
        for (part, skipped) in parts.iter_mut().zip(self.skipped) {
            part.xl_end = part.xl_end.wrapping_add(self.first_sample).wrapping_add(skipped);
        }
    }

    pub fn config(&mut self, frame: u32) -> RuntimeConfig {
        let mut config = RuntimeConfig::DEFAULT;
        for (fault, effect) in self.at(frame) {
            if let Setting(change) = effect {
                change(&mut config, fault.sensor);
            }
        }
        config
    }

    pub fn read_ns(&mut self, frame: u32) -> u64 {
        let begins = |(fault, effect): (&Fault, _)| matches!(effect, SlowRead) && frame == fault.frames.start;
        if self.at(frame).any(begins) { SLOW_NS } else { 0 }
    }
}
