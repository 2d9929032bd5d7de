//! What was on the bus against the host: raw messages against the episode that the sensors played, slip messages
//! against the host's pipeline fed with what the raw messages carried, bit for bit.

use std::collections::BTreeMap;

use anyhow::{Result, anyhow};
use slipsense::health;
use slipsense::net::{Aligned, Model};
use slipsense::params::{MAX_SENSORS, TAXEL_COLS};
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{
    DEGRADED_LATE, DEGRADED_NOT_CALIBRATED, DEGRADED_SELF_TEST, IdError, NodeId, Origin, RawMessage,
    ReceiveError, Received, Receiver, SlipMessage,
};
use slipsense_can_sim::Outcome;
use slipsense_recording::Episode;

use crate::fdcan::wire::{MCU, can_frame};
use crate::run::Done;

/// Flags of a frame before whose samples others are missing.
const GAP: u8 = health::XL_SAMPLES_DROPPED | health::XL_WARMING_UP;

const MODEL: &[u8] = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;
/// 1/240 s.
const PERIOD_US: u64 = 4_166;
/// Ticks of the board's own timer are this far from 240 Hz at most.
const PERIOD_SLACK_US: u64 = 4;
/// A count of whole samples is up to one behind the clock that makes them; and a FIFO is read the later, the more the
/// one before it held.
const XL_CLOCK_SPREAD_MAX: f64 = 1.5;

/// Scans that may go by before the first that is sent.
const SHIFT_MAX: usize = 16;

/// Raw messages by frame number and sensor.
type Raws = BTreeMap<(u32, u8), RawMessage>;

#[derive(Clone, Debug)]
pub struct Slip {
    pub message: SlipMessage,
    pub start_ns: u64,
    pub end_ns: u64,
}

#[derive(Debug, Default)]
pub struct Comparison {
    pub slips: Vec<Slip>,
    pub raws: usize,
    /// Frames of the bus that were no message.
    pub undecoded: Vec<String>,
    pub missed_transfers: u32,
    /// Slip messages compared with the host's, and those that differ.
    pub compared: usize,
    pub different: Vec<String>,
    /// Readings among them that the bus did not carry.
    pub from_models: usize,
    /// Frame number less frame of the episode, by sensor.
    shift: [usize; MAX_SENSORS],
    /// Why the comparison ended before the last message.
    pub ended: Option<String>,
    /// Raw messages whose counts are those of a frame of the episode, and those that are not.
    pub taxels_equal: usize,
    pub taxels_different: Vec<String>,
    /// Samples equal to the episode's, in sequence without a gap; and breaks.
    pub samples_equal: usize,
    pub samples_different: Vec<String>,
    /// Where `xl_end` does not count these samples, or not as the part's clock does.
    pub xl_end_different: Vec<String>,
    /// How far `xl_end` ran from that clock, least to most, samples.
    pub xl_clock_spread: f64,
    /// Frame numbers that were left out, and ticks that were not 1/240 s apart.
    pub skipped: u32,
    pub uneven: Vec<String>,
}

fn difference(expected: &PiezoFrame, found: &PiezoFrame) -> String {
    let pairs =
        || expected.counts().iter().zip(found.counts()).enumerate().filter(|(_, (one, two))| one != two);
    let first = pairs().next().map(|(taxel, (one, two))| {
        format!("row {} column {} is {two}, played was {one}", taxel / TAXEL_COLS, taxel % TAXEL_COLS)
    });
    format!("{} taxels differ, the first: {}", pairs().count(), first.unwrap_or_default())
}

/// Of the frame of this message, in virtual time.
pub fn tick_ns(message: &SlipMessage, ahead_ns: i64) -> u64 {
    (message.timestamp_us as i64 * 1000 - ahead_ns).max(0) as u64
}

/// What was read of a FIFO for the frame of a tick: in the period around it.
fn readout(readouts: &[(u64, Vec<XlSample>)], tick_ns: u64) -> Option<&[XlSample]> {
    let begin = tick_ns.saturating_sub(PERIOD_US * 1000 / 2);
    let first = readouts.partition_point(|(at, _)| *at <= begin);
    let (at, samples) = readouts.get(first)?;
    (at - begin < PERIOD_US * 1000).then_some(samples)
}

pub fn compare(done: &Done, episode: Option<&Episode>) -> Result<Comparison> {
    let frames = &done.frames;
    let mut comparison = Comparison::default();
    let mut receiver = Receiver::new(NodeId::DEFAULT);
    let mut raws = Raws::new();
    for logged in frames.iter().filter(|logged| logged.node == MCU && logged.outcome == Outcome::Sent) {
        let Some(frame) = can_frame(&logged.frame) else {
            comparison.undecoded.push(format!("{:?}", logged.frame));
            continue;
        };
        match receiver.accept(&frame) {
            Ok(Some(Received::Slip(message))) => {
                comparison.slips.push(Slip { message, start_ns: logged.start_ns, end_ns: logged.end_ns });
            }
            Ok(Some(Received::Raw(raw))) => {
                raws.insert((raw.sequence, raw.sensor), raw);
            }
            // Of the services.
            Ok(None) | Err(ReceiveError::Id(IdError::Service)) => {}
            Err(error) => comparison.undecoded.push(format!("{error:?}")),
        }
    }
    comparison.raws = raws.len();
    comparison.missed_transfers = receiver.missed();
    comparison.ticks();
    if let Some(episode) = episode {
        comparison.sensors(&raws, done, episode);
    }
    comparison.decisions(&raws, done, episode)?;
    Ok(comparison)
}

impl Comparison {
    fn ticks(&mut self) {
        for pair in self.slips.windows(2) {
            let (one, two) = (&pair[0].message, &pair[1].message);
            let frames = two.sequence.wrapping_sub(one.sequence);
            self.skipped += frames.saturating_sub(1);
            let elapsed = two.timestamp_us.saturating_sub(one.timestamp_us);
            let nominal = PERIOD_US * u64::from(frames);
            if frames == 0 || elapsed.abs_diff(nominal) > PERIOD_SLACK_US * u64::from(frames) {
                self.uneven.push(format!("frame {}: {elapsed} us after the one before", two.sequence));
            }
        }
    }

    /// The host's pipeline decides on the very readings that the raw messages carry; where the bus did not carry one,
    /// on what the sensor models gave: the scan that follows, and what was read of the FIFO around the tick.
    fn decisions(&mut self, raws: &Raws, done: &Done, episode: Option<&Episode>) -> Result<()> {
        let model = Model::parse(MODEL).map_err(|error| anyhow!("the bundled model: {error}"))?;
        let sensors = self.slips.first().map_or(1, |slip| slip.message.sensors.into());
        let mut pipeline = Pipeline::new(model, sensors).map_err(|error| anyhow!("pipeline: {error}"))?;
        let ahead_ns = clock_ahead_ns(done, &self.slips);
        let ends: Vec<_> = (0..sensors).map(|sensor| self.xl_ends(raws, done, ahead_ns, sensor)).collect();
        let mut xl_end = [0u32; MAX_SENSORS];
        let mut next = None;
        for (index, slip) in self.slips.iter().enumerate() {
            let (message, number) = (&slip.message, slip.message.sequence);
            // The network remembers the frames that the bus did not carry.
            if next.is_some_and(|next| next != number) {
                self.ended = Some(format!("frame {number}: those before it were not on the bus"));
                return Ok(());
            }
            next = Some(number.wrapping_add(1));
            let tick_ns = tick_ns(message, ahead_ns);
            let mut inputs = [SensorInput::default(); MAX_SENSORS];
            for (sensor, input) in inputs.iter_mut().enumerate().take(sensors) {
                let flags = message.contact[sensor].health;
                let raw = raws.get(&(number, sensor as u8));
                let piezo = raw.map(|raw| &raw.piezo).or_else(|| {
                    let frame = (number as usize).checked_sub(self.shift[sensor])?;
                    episode.map(|episode| episode.piezo(frame % episode.frames(), sensor))
                });
                let read = readout(&done.readouts[sensor], tick_ns);
                if let (Some(raw), Some(read)) = (raw, read)
                    && flags & health::XL_MISSING == 0
                    && !(read.ends_with(&raw.xl) && read.len() == raw.xl.len() + usize::from(raw.xl_dropped))
                {
                    self.samples_different.push(format!("frame {number}: not the samples that were read"));
                }
                // A message holds the newest samples of a FIFO that was full.
                let carried = raw.filter(|raw| raw.xl_dropped == 0);
                let none = (flags & health::XL_MISSING != 0).then_some(&[][..]);
                let xl = carried.map(|raw| raw.xl.as_slice()).or(read).or(none);
                let (Some(piezo), Some(xl)) = (piezo, xl) else {
                    self.ended = Some(format!("frame {number}: no reading of sensor {sensor} is known"));
                    return Ok(());
                };
                self.from_models += usize::from(carried.is_none());
                input.piezo = (flags & health::PIEZO_MISSING == 0).then_some(piezo);
                input.xl = (flags & health::XL_MISSING == 0).then_some(xl);
                // Without a raw message of it or after it, the flags say whether samples are missing before this frame's.
                let counted = xl_end[sensor].wrapping_add(xl.len() as u32 + u32::from(flags & GAP == GAP));
                input.xl_end = ends[sensor][index].unwrap_or(counted);
                xl_end[sensor] = input.xl_end;
            }
            let output = pipeline.step(&inputs[..sensors]);
            let stamp = FrameStamp { sequence: number, timestamp_us: message.timestamp_us };
            let origin = Origin {
                starts: message.starts,
                late_frames: message.late_frames,
                late: message.degraded & DEGRADED_LATE != 0,
                self_test_failed: message.degraded & DEGRADED_SELF_TEST != 0,
                locked: message.locked,
                ..Origin::default()
            };
            let mut expected = output.slip_message(stamp, &origin);
            if message.degraded & DEGRADED_NOT_CALIBRATED == 0 {
                // The names of the calibrations are not known here.
                expected.degraded &= !DEGRADED_NOT_CALIBRATED;
                expected.configuration = message.configuration;
            }
            self.compared += 1;
            if expected != *message {
                self.different.push(format!("frame {number}: {message:?}, the host says {expected:?}"));
            }
        }
        Ok(())
    }

    /// `xl_end` of each slip message's frame: its raw message's, or that of a later one, less the samples read since
    /// then, if none are missing in between.
    fn xl_ends(&self, raws: &Raws, done: &Done, ahead_ns: i64, sensor: usize) -> Vec<Option<u32>> {
        let mut later: Option<(u32, u32)> = None;
        let mut ends = Vec::with_capacity(self.slips.len());
        for slip in self.slips.iter().rev() {
            let (number, flags) = (slip.message.sequence, slip.message.contact[sensor].health);
            let raw = raws.get(&(number, sensor as u8));
            let of_later = later.filter(|(later, _)| number.wrapping_add(1) == *later).map(|(_, end)| end);
            let end = raw.map(|raw| raw.xl_end).or(of_later);
            let read = readout(&done.readouts[sensor], tick_ns(&slip.message, ahead_ns));
            let whole = flags & health::XL_MISSING == 0 && flags & GAP != GAP;
            later = end
                .zip(read)
                .filter(|_| whole)
                .map(|(end, read)| (number, end.wrapping_sub(read.len() as u32)));
            ends.push(end);
        }
        ends.reverse();
        ends
    }

    fn sensors(&mut self, raws: &Raws, done: &Done, episode: &Episode) {
        for sensor in 0..episode.sensors {
            let of_sensor = raws.values().filter(|raw| usize::from(raw.sensor) == sensor);
            let of_sensor: Vec<&RawMessage> = of_sensor.collect();
            self.taxels(&of_sensor, episode, sensor);
            self.samples(&of_sensor, &episode.xl[sensor], done.xl_rate_hz);
        }
    }

    /// The arrays play one frame of the episode per scan, so frame number and frame of the episode differ by a
    /// constant: the one that most frames agree with, for an untouched pad reads the same in many.
    fn taxels(&mut self, raws: &[&RawMessage], episode: &Episode, sensor: usize) {
        let scans = raws.iter().filter(|raw| raw.health & health::PIEZO_MISSING == 0);
        let scans: Vec<(usize, &PiezoFrame)> = scans.map(|raw| (raw.sequence as usize, &raw.piezo)).collect();
        let played = |sequence: usize, shift: usize| {
            let frame = sequence.checked_sub(shift)?;
            Some(episode.piezo(frame % episode.frames(), sensor))
        };
        let agreeing = |shift: &usize| {
            scans.iter().filter(|(sequence, scan)| played(*sequence, *shift) == Some(*scan)).count()
        };
        let shift = (0..SHIFT_MAX).max_by_key(agreeing).unwrap_or(0);
        self.shift[sensor] = shift;
        for (sequence, scan) in scans {
            // Before its beginning nothing is played.
            let Some(expected) = played(sequence, shift) else { continue };
            if expected == scan {
                self.taxels_equal += 1;
            } else {
                self.taxels_different
                    .push(format!("frame {sequence}, sensor {sensor}: {}", difference(expected, scan)));
            }
        }
    }

    /// Samples follow one another as the part made them, the episode's over and over, and `xl_end` counts them; the
    /// first ones are thrown away while the part settles.
    fn samples(&mut self, raws: &[&RawMessage], played: &[XlSample], rate_hz: f64) {
        let follow = |from: usize, batch: &[XlSample]| {
            (from..).zip(batch).all(|(index, sample)| played[index % played.len()] == *sample)
        };
        let mut last: Option<(u32, usize)> = None;
        let mut ahead: Option<f64> = None;
        let (mut least, mut most) = (f64::INFINITY, f64::NEG_INFINITY);
        for raw in raws.iter().filter(|raw| raw.health & health::XL_MISSING == 0 && !raw.xl.is_empty()) {
            let (sequence, batch) = (raw.sequence, raw.xl.as_slice());
            let next = last.map_or(0, |(_, next)| next);
            // After messages that the bus did not carry, or a gap: the first such samples from there on.
            let follows = last.is_some_and(|(last, _)| sequence == last + 1) && raw.health & GAP != GAP;
            let from = if follows {
                next + usize::from(raw.xl_dropped)
            } else if let Some(from) = (next..next + played.len()).find(|from| follow(*from, batch)) {
                from
            } else {
                self.samples_different.push(format!("frame {sequence}: samples that the part did not make"));
                continue;
            };
            if follow(from, batch) {
                self.samples_equal += batch.len();
            } else {
                self.samples_different.push(format!("frame {sequence}: not the samples that follow"));
            }
            let end = from + batch.len();
            last = Some((sequence, end));
            // The count began before the episode's first sample.
            let before = f64::from(raw.xl_end) - end as f64;
            if *ahead.get_or_insert(before) != before {
                self.xl_end_different.push(format!(
                    "frame {sequence}: xl_end {} after sample {end} of the episode",
                    raw.xl_end
                ));
                ahead = Some(before);
            }
            let off = f64::from(raw.xl_end) - raw.timestamp_us as f64 * 1e-6 * rate_hz;
            (least, most) = (least.min(off), most.max(off));
        }
        // Less than nothing where no sample came.
        self.xl_clock_spread = self.xl_clock_spread.max(most - least);
        if most - least > XL_CLOCK_SPREAD_MAX {
            self.xl_end_different
                .push(format!("xl_end runs {:.2} samples off the part's {rate_hz:.1} Hz", most - least));
        }
    }

    /// What differs, kind by kind.
    pub fn differences(&self) -> [&Vec<String>; 5] {
        let Self { undecoded, different, taxels_different, samples_different, xl_end_different, .. } = self;
        [undecoded, different, taxels_different, samples_different, xl_end_different]
    }

    /// Nothing differs, and there was something to compare.
    pub fn is_equal(&self, played: bool) -> bool {
        let sensors = !played || self.taxels_equal > 0 && self.samples_equal > 0;
        sensors && self.differences().iter().all(|list| list.is_empty()) && self.compared > 0
    }
}

/// How far the firmware's clock is ahead of virtual time, which began with the reset: its lowest 16 bits are known at
/// the end of the run, the others by the last message, which is milliseconds old.
pub fn clock_ahead_ns(done: &Done, slips: &[Slip]) -> i64 {
    let Some(last) = slips.last() else { return 0 };
    let about_us = last.message.timestamp_us + (done.virtual_ns - last.start_ns) / 1000;
    let off = (done.clock_us as i64 - about_us as i64).rem_euclid(1 << 16);
    let off = if off >= 1 << 15 { off - (1 << 16) } else { off };
    (about_us as i64 + off) * 1000 - done.virtual_ns as i64
}
