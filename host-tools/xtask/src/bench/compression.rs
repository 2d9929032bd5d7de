//! The raw frames compressed: how long they become beside what other coders make of the same frames, what that is of
//! a bus, and what it costs on the Cortex-M7.

use anyhow::{Context, Result, anyhow, ensure};
use serde::Serialize;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::sensor::SensorInput;
use slipsense::wire::{
    CanFrame, Detail, NodeId, RawBuffer, RawForm, RawFrame, RawMessage, SlipMessage, Transmitter,
};
use slipsense_can_sim::{Format, Frame, Id, Timing};
use slipsense_recording::Episode;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED};
use slipsense_synth::{Split, generate};

use super::emulated;
use super::inputs::{Input, demo};
use super::other_coders::{CODERS, Samples};
use crate::qemu::frames::Frames;
use crate::root;

/// Clock that both bit rates divide.
const CLOCK_HZ: u32 = 80_000_000;
const NOMINAL_BPS: u32 = 1_000_000;
/// Data bit rates, bit/s.
const DATA_BPS: [u32; 2] = [5_000_000, 8_000_000];
/// Every so manieth frame: neighbours say the same.
const EVERY: usize = 7;
/// Episodes of each frozen set.
const EPISODES: usize = 4;
/// Recordings that cannot be part of the repository, where someone has them.
const REAL_EPISODES: &str = "../shared/real";

/// What the frames of some episodes become.
#[derive(Clone, Debug, Serialize)]
pub struct Data {
    pub name: String,
    /// Sensors' frames.
    pub frames: usize,
    /// Bytes of a plain message, mean.
    pub plain_bytes: f64,
    /// By coder, this project's first: name and mean bytes of a sensor's frame.
    pub coders: Vec<(String, f64)>,
    /// Longest message of this project's, bytes.
    pub longest_bytes: usize,
    pub loads: Vec<Load>,
}

/// Share of a bus that slip and compressed raw messages take.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Load {
    pub data_bps: u32,
    pub sensors: usize,
    /// Mean over the frames, and the fullest period.
    pub mean: f64,
    pub worst: f64,
    /// Mean of the plain form.
    pub plain_mean: f64,
}

/// On the emulated core.
#[derive(Clone, Debug, Serialize)]
pub struct Cost {
    pub input: &'static str,
    /// Sensors' frames.
    pub frames: usize,
    pub mean_bytes: f64,
    /// The most bytes that a compressed message has more than the plain one; negative where all have fewer.
    pub longer_bytes: i64,
    pub median: u32,
    pub worst: u32,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct Compression {
    pub data: Vec<Data>,
    pub costs: Vec<Cost>,
}

/// Measure everything; `frames` of each input on the emulated core.
pub fn measure(model: &[u8], frames: usize) -> Result<Compression> {
    let mut data = vec![measure_data("demo, synthetic", &[demo()?])?];
    for split in [Split::UmiId, Split::UmiOod] {
        let set = EpisodeSet::first(split, FROZEN_SEED, EPISODES);
        let episodes: Result<Vec<_>, _> =
            set.episodes.iter().map(|planned| generate(&planned.recipe)).collect();
        let name = format!("first {EPISODES} episodes of the frozen set {split}, synthetic");
        data.push(measure_data(&name, &episodes?)?);
    }
    match real()? {
        episodes if episodes.is_empty() => {
            eprintln!("no episodes of real recordings in {REAL_EPISODES}: not measured")
        }
        episodes => data.push(measure_data("composed from real recordings", &episodes)?),
    }
    let costs = Input::COMPRESSED.map(|input| {
        let frames = input.frames(MAX_SENSORS, frames)?;
        let costs = emulated::compressed(model, &frames)?;
        let longer_bytes = longest_beside_plain(&frames, &costs)?;
        let mut instructions: Vec<u32> = costs.iter().map(|&(_, instructions)| instructions).collect();
        instructions.sort_unstable();
        Ok(Cost {
            input: input.name(),
            frames: costs.len(),
            mean_bytes: mean(costs.iter().map(|&(bytes, _)| f64::from(bytes))),
            longer_bytes,
            median: instructions[instructions.len() / 2],
            worst: *instructions.last().context("no frame was compressed")?,
        })
    });
    Ok(Compression { data, costs: costs.into_iter().collect::<Result<_>>()? })
}

/// The most that a message is longer than plain; the emulated core and this computer make the same lengths.
fn longest_beside_plain(frames: &Frames, costs: &[(u32, u32)]) -> Result<i64> {
    let mut buffer = RawBuffer::new();
    let parts = frames.iter().flat_map(|(stamp, parts)| {
        parts.iter().enumerate().map(move |(sensor, part)| RawFrame {
            timestamp_us: stamp.timestamp_us,
            sequence: stamp.sequence,
            sensor: sensor as u8,
            health: 0,
            input: part.input(),
            xl_end: part.xl_end,
        })
    });
    let (mut longest, mut count) = (i64::MIN, 0);
    for (raw, &(bytes, _)) in parts.zip(costs) {
        let here = raw.compress(Detail::All, &mut buffer).len();
        ensure!(here == bytes as usize, "{bytes} bytes on the emulated core, {here} on this computer");
        longest = longest.max(i64::from(bytes) - raw.encode(&mut buffer).len() as i64);
        count += 1;
    }
    ensure!(count == frames.len() * frames.sensors(), "{} messages of {count}", costs.len());
    Ok(longest)
}

fn real() -> Result<Vec<Episode>> {
    let Ok(dir) = root().join(REAL_EPISODES).read_dir() else { return Ok(Vec::new()) };
    let mut paths = dir.map(|entry| Ok(entry?.path())).collect::<Result<Vec<_>>>()?;
    paths.retain(|path| path.extension().is_some_and(|extension| extension == "npz"));
    paths.sort();
    paths.iter().map(|path| Ok(Episode::read(path)?)).collect()
}

fn measure_data(name: &str, episodes: &[Episode]) -> Result<Data> {
    eprintln!("compressing: {name}");
    let mut buffer = RawBuffer::new();
    let (mut plain, mut ours, mut others) = (Vec::new(), Vec::new(), vec![Vec::new(); CODERS.len()]);
    let mut loads = Vec::new();
    for (data_bps, sensors) in DATA_BPS.into_iter().flat_map(|bps| (1..=MAX_SENSORS).map(move |n| (bps, n))) {
        loads.push((data_bps, sensors, Vec::new(), Vec::new()));
    }
    for episode in episodes {
        for frame in (0..episode.frames()).step_by(EVERY) {
            // A third sensor feels what the first does.
            let raws: [RawFrame<'_>; MAX_SENSORS] =
                std::array::from_fn(|sensor| raw_frame(episode, frame, sensor % episode.sensors));
            for raw in raws.iter().take(episode.sensors) {
                let message = raw.encode(&mut buffer).to_vec();
                let compressed = raw.compress(Detail::All, &mut buffer);
                let back = RawMessage::decompress(compressed).map_err(|error| anyhow!("{error}"))?;
                ensure!(RawMessage::decode(&message).as_ref() == Ok(&back), "a frame came back as another");
                plain.push(message.len());
                ours.push(compressed.len());
                let samples = Samples::of(raw, message);
                for (sizes, coder) in others.iter_mut().zip(CODERS) {
                    sizes.push((coder.size)(&samples)?);
                }
            }
            for (data_bps, sensors, short, long) in &mut loads {
                let raws = &raws[..*sensors];
                short.push(load(*data_bps, raws, RawForm::Compressed(Detail::All))?);
                long.push(load(*data_bps, raws, RawForm::Plain)?);
            }
        }
    }
    let sizes = |sizes: &[usize]| mean(sizes.iter().map(|&size| size as f64));
    let mut coders = vec![("slipsense".to_owned(), sizes(&ours))];
    coders.extend(CODERS.iter().zip(&others).map(|(coder, all)| (coder.name.to_owned(), sizes(all))));
    Ok(Data {
        name: name.to_owned(),
        frames: ours.len(),
        plain_bytes: sizes(&plain),
        coders,
        longest_bytes: ours.iter().copied().max().unwrap_or(0),
        loads: loads
            .into_iter()
            .map(|(data_bps, sensors, short, long)| Load {
                data_bps,
                sensors,
                mean: mean(short.iter().copied()),
                worst: short.iter().copied().fold(0.0, f64::max),
                plain_mean: mean(long.iter().copied()),
            })
            .collect(),
    })
}

fn raw_frame(episode: &Episode, frame: usize, sensor: usize) -> RawFrame<'_> {
    let input =
        SensorInput { piezo: Some(episode.piezo(frame, sensor)), xl: Some(episode.xl_batch(frame, sensor)) };
    let timestamp_us = frame as u64 * 1_000_000 / u64::from(FRAME_RATE_HZ);
    let xl_end = episode.xl_end(frame, sensor);
    RawFrame { timestamp_us, sequence: frame as u32, sensor: sensor as u8, health: 0, input, xl_end }
}

/// Share of a frame period that the slip message and these raw messages keep the bus, by the bits of each frame.
fn load(data_bps: u32, raws: &[RawFrame<'_>], form: RawForm) -> Result<f64> {
    let timing = Timing::new(CLOCK_HZ, NOMINAL_BPS, data_bps).map_err(|error| anyhow!("{error:?}"))?;
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut buffer = RawBuffer::new();
    let mut cycles = time(&timing, &transmitter.slip(&SlipMessage::default()))?;
    for raw in raws {
        for frame in transmitter.raw_as(form, raw, &mut buffer) {
            cycles += time(&timing, &frame)?;
        }
    }
    Ok((cycles * u64::from(FRAME_RATE_HZ)) as f64 / f64::from(CLOCK_HZ))
}

/// Clock cycles of a frame and the pause after it.
fn time(timing: &Timing, frame: &CanFrame) -> Result<u64> {
    let frame =
        Frame::new(Id::Extended(frame.id()), Format::FD, frame.data()).map_err(|e| anyhow!("{e:?}"))?;
    Ok(timing.frame(&frame) + timing.intermission())
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}
