//! Writes `episode.npz`, `predictions.npz` and `can.log` of random values that belong together, to test
//! the checker of logs (`tests/python/check_can_log.py`) at edges that no real episode reaches: every
//! count and logit, batches of no sample and of more samples than a raw frame holds.
//!
//! `cargo run -p slipsense-recording --example random_log -- DIR [FRAMES] [SENSORS]`

use std::error::Error;
use std::fs::{File, create_dir_all};
use std::path::Path;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::fixed::Q;
use slipsense::health;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS, MEL_BINS};
use slipsense::sensor::{PiezoFrame, SensorInput};
use slipsense::wire::{NodeId, RAW_XL_MAX, RawBuffer, RawFrame, SensorContact, SlipMessage, Transmitter};
use slipsense_recording::candump::CandumpWriter;
use slipsense_recording::{Episode, Meta, Predictions};

const START_US: u64 = 1_700_000_000_000_000;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("usage: random_log DIR [FRAMES] [SENSORS]")?;
    let frames: usize = arguments.next().as_deref().unwrap_or("1200").parse()?;
    let sensors: usize = arguments.next().as_deref().unwrap_or("2").parse()?;
    if !(1..=MAX_SENSORS).contains(&sensors) {
        return Err(format!("{sensors} sensors: need 1 to {MAX_SENSORS}").into());
    }
    let folder = Path::new(&folder);
    create_dir_all(folder)?;
    let mut rng = ChaCha8Rng::seed_from_u64(6_200);
    let episode = random_episode(&mut rng, frames, sensors);
    episode.write(folder.join("episode.npz"))?;
    let predictions = Predictions {
        sensors,
        class: (0..frames).map(|_| rng.random_range(0..3)).collect(),
        logits: (0..frames).map(|_| rng.random()).collect(),
        slip: (0..frames).map(|_| rng.random_range(0..2)).collect(),
        alarm: (0..frames).map(|_| rng.random_range(0..2)).collect(),
        logmel: vec![[0.0; MEL_BINS]; frames * sensors],
        logmel_std: vec![[0.0; MEL_BINS]; frames * sensors],
    };
    predictions.write(folder.join("predictions.npz"))?;
    write_log(&mut rng, &episode, &predictions, File::create(folder.join("can.log"))?)
}

fn random_episode(rng: &mut ChaCha8Rng, frames: usize, sensors: usize) -> Episode {
    let mut ends = vec![0u32; sensors];
    let mut xl_end = Vec::new();
    for frame in 0..frames {
        for end in &mut ends {
            *end += match frame % 50 {
                7 => 0,
                8 => RAW_XL_MAX as u32,
                9 => rng.random_range(65..600),
                _ => rng.random_range(30..38),
            };
            xl_end.push(*end);
        }
    }
    let samples = ends.iter().copied().max().unwrap_or(0);
    Episode {
        sensors,
        piezo: (0..frames * sensors)
            .map(|_| PiezoFrame::from_scan(std::array::from_fn(|_| rng.random())))
            .collect(),
        xl: (0..sensors).map(|_| (0..samples).map(|_| rng.random()).collect()).collect(),
        xl_end,
        label: None,
        slip_true_mm_s: None,
        slip_fraction: None,
        displacement_mm: None,
        meta: Meta::nominal(0.000_488),
    }
}

fn write_log(
    rng: &mut ChaCha8Rng,
    episode: &Episode,
    predictions: &Predictions,
    out: File,
) -> Result<(), Box<dyn Error>> {
    let mut log = CandumpWriter::new(out, "can0")?;
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut buffer = RawBuffer::new();
    for frame in 0..episode.frames() {
        let timestamp_us = frame as u64 * 1_000_000 / u64::from(FRAME_RATE_HZ);
        let sequence = frame as u32;
        let mut contact = [SensorContact::default(); MAX_SENSORS];
        for (sensor, contact) in contact.iter_mut().enumerate().take(episode.sensors) {
            let dropped = episode.xl_batch(frame, sensor).len() > RAW_XL_MAX;
            *contact = SensorContact {
                health: if dropped { health::XL_SAMPLES_DROPPED } else { 0 },
                sum: episode.piezo(frame, sensor).sum(),
                area: rng.random(),
                centroid_row: Q::from_bits(rng.random()),
                centroid_col: Q::from_bits(rng.random()),
                axis_deg: rng.random(),
                elongation: Q::from_bits(rng.random()),
            };
        }
        let message = SlipMessage {
            timestamp_us,
            sequence,
            class: predictions.class[frame],
            slip: predictions.slip[frame] != 0,
            alarm: predictions.alarm[frame] != 0,
            logits: predictions.logits[frame].map(Q::from_bits),
            late_frames: rng.random(),
            sensors: episode.sensors as u8,
            contact,
        };
        log.write(START_US + timestamp_us, &transmitter.slip(&message))?;
        for (sensor, contact) in contact.iter().enumerate().take(episode.sensors) {
            let raw = RawFrame {
                timestamp_us,
                sequence,
                sensor: sensor as u8,
                health: contact.health,
                input: SensorInput {
                    piezo: Some(episode.piezo(frame, sensor)),
                    xl: Some(episode.xl_batch(frame, sensor)),
                    xl_end: episode.xl_end(frame, sensor),
                },
            };
            for frame in transmitter.raw(&raw, &mut buffer) {
                log.write(START_US + timestamp_us, &frame)?;
            }
        }
    }
    log.finish()?;
    Ok(())
}
