//! The raw frames compressed: how long they become, what that is of a bus, and what it costs on the Cortex-M7.

use anyhow::{Context, Result, anyhow, ensure};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorInput;
use slipsense::wire::{
    CanFrame, Detail, NodeId, RawBuffer, RawForm, RawFrame, RawMessage, SlipMessage, Transmitter,
};
use slipsense_can_sim::{Format, Frame, Id, Timing};
use slipsense_recording::Episode;

use super::emulated;
use super::inputs::{Input, demo, real_episodes};
use crate::process::{command, empty_dir, run, small_cli};
use crate::qemu::frames::Frames;
use crate::table::{Table, median_and_worst, thousands};

/// Clock that both bit rates divide.
const CLOCK_HZ: u32 = 80_000_000;
const NOMINAL_BPS: u32 = 1_000_000;
/// Data bit rates, bit/s.
const DATA_BPS: [u32; 2] = [5_000_000, 8_000_000];
/// One frame in this many is taken: neighbours are alike.
const STRIDE: usize = 7;
const EPISODES: usize = 4;
/// Enough for [`EPISODES`].
const FRAMES: &str = "20000";

/// Measure everything; `frames` of each input on the emulated core.
pub fn print(model: &[u8], frames: usize) -> Result<()> {
    let mut lengths = Table::new(
        "A sensor's raw frame, bytes, mean over the frames",
        &["data", "plain", "compressed", "ratio", "longest compressed"],
    );
    let mut loads = Table::new(
        "Share of the bus, slip message included, by the bits of every frame; 240 frames/s",
        &["data", "Mbit/s", "sensors", "mean", "fullest period", "plain, mean"],
    );
    let mut print = |name: &str, episodes: &[Episode]| {
        eprintln!("compressing: {name}");
        measure_lengths(name, episodes, &mut lengths)?;
        measure_loads(name, episodes, &mut loads)
    };
    print("demo, synthetic", &[demo()?])?;
    let slipsense = small_cli()?;
    for split in ["umi_id", "umi_ood"] {
        let set = empty_dir(format!("bench-{split}"))?;
        run(command(&slipsense).args(["synth", "--split", split, "--frames", FRAMES, "--out"]).arg(&set))?;
        let episode = |index| Ok(Episode::read(set.join(format!("{split}-{index:05}.npz")))?);
        let episodes = (0..EPISODES).map(episode).collect::<Result<Vec<_>>>()?;
        print(&format!("first {EPISODES} episodes of the frozen set {split}, synthetic"), &episodes)?;
    }
    let real = real_episodes()?.iter().map(|path| Ok(Episode::read(path)?)).collect::<Result<Vec<_>>>()?;
    if !real.is_empty() {
        print("composed from real recordings", &real)?;
    }
    let mut costs = Table::new(
        "Instructions to compress a sensor's frame, exact, emulated Cortex-M7",
        &["input", "median", "worst", "bytes, mean", "most bytes over plain", "frames"],
    );
    for input in Input::COMPRESSED {
        let frames = input.frames(MAX_SENSORS, frames)?;
        let compressed = emulated::compressed(model, &frames)?;
        let [median, worst] =
            median_and_worst(compressed.iter().map(|&[_, instructions]| instructions).collect());
        costs.row([
            input.name().to_owned(),
            thousands(median),
            thousands(worst),
            format!("{:.0}", mean(compressed.iter().map(|&[bytes, _]| f64::from(bytes)))),
            format!("{:+}", most_over_plain(&frames, &compressed)?),
            compressed.len().to_string(),
        ]);
    }
    print!("{lengths}{loads}{costs}");
    Ok(())
}

/// The most bytes that a message has more than the plain one; the emulated core and this computer make the same
/// lengths.
fn most_over_plain(frames: &Frames, compressed: &[[u32; 2]]) -> Result<i64> {
    let mut buffer = RawBuffer::new();
    let raws = frames.list.iter().flat_map(|(stamp, parts)| {
        parts.iter().enumerate().map(|(sensor, part)| raw_frame(*stamp, sensor, part.input()))
    });
    let count = compressed.len();
    ensure!(count == frames.list.len() * frames.sensors, "{count} messages");
    let mut most = i64::MIN;
    for (raw, &[bytes, _]) in raws.zip(compressed) {
        let here = raw.compress(Detail::All, &mut buffer).len();
        ensure!(here == bytes as usize, "{bytes} bytes on the emulated core, {here} on this computer");
        most = most.max(i64::from(bytes) - raw.encode(&mut buffer).len() as i64);
    }
    Ok(most)
}

/// The frames that are taken, each with a raw frame for every sensor; a third sensor feels what the first does.
fn raw_frames(episodes: &[Episode]) -> impl Iterator<Item = (&Episode, [RawFrame<'_>; MAX_SENSORS])> {
    episodes.iter().flat_map(|episode| {
        (0..episode.frames()).step_by(STRIDE).map(move |frame| {
            let (stamp, inputs) = (FrameStamp::of_recording(frame as u32), episode.inputs(frame));
            let raw = |sensor| {
                let sensor = sensor % episode.sensors;
                raw_frame(stamp, sensor, inputs[sensor])
            };
            (episode, std::array::from_fn(raw))
        })
    })
}

fn measure_lengths(name: &str, episodes: &[Episode], table: &mut Table) -> Result<()> {
    let mut buffer = RawBuffer::new();
    let (mut plain, mut compressed) = (Vec::new(), Vec::new());
    for (episode, raws) in raw_frames(episodes) {
        for raw in raws.iter().take(episode.sensors) {
            let message = raw.encode(&mut buffer).to_vec();
            let short = raw.compress(Detail::All, &mut buffer);
            let back = RawMessage::decompress(short).map_err(|error| anyhow!("{error}"))?;
            ensure!(RawMessage::decode(&message).as_ref() == Ok(&back), "a frame came back as another");
            plain.push(message.len() as f64);
            compressed.push(short.len() as f64);
        }
    }
    let longest = compressed.iter().copied().fold(0.0, f64::max);
    let [plain, compressed] = [plain, compressed].map(|lengths| mean(lengths.into_iter()));
    let [a, b, c, d] = [(plain, 0), (compressed, 0), (plain / compressed, 2), (longest, 0)]
        .map(|(value, decimals)| format!("{value:.decimals$}"));
    table.row([name.to_owned(), a, b, c, d]);
    Ok(())
}

fn measure_loads(name: &str, episodes: &[Episode], table: &mut Table) -> Result<()> {
    for (data_bps, sensors) in DATA_BPS.into_iter().flat_map(|bps| (1..=MAX_SENSORS).map(move |n| (bps, n))) {
        let shares = |form| {
            raw_frames(episodes)
                .map(|(_, raws)| load(data_bps, &raws[..sensors], form))
                .collect::<Result<Vec<_>>>()
        };
        let (short, plain) = (shares(RawForm::Compressed(Detail::All))?, shares(RawForm::Plain)?);
        let fullest = short.iter().copied().fold(0.0, f64::max);
        let [a, b, c] = [mean(short.into_iter()), fullest, mean(plain.into_iter())]
            .map(|share| format!("{:.1} %", 100.0 * share));
        table.row([name.to_owned(), format!("1/{}", data_bps / 1_000_000), sensors.to_string(), a, b, c]);
    }
    Ok(())
}

fn raw_frame(stamp: FrameStamp, sensor: usize, input: SensorInput<'_>) -> RawFrame<'_> {
    let FrameStamp { sequence, timestamp_us } = stamp;
    RawFrame { timestamp_us, sequence, sensor: sensor as u8, health: 0, input }
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
    let frame = Frame::new(Id::Extended(frame.id()), Format::FD, frame.data());
    let frame = frame.map_err(|error| anyhow!("{error:?}")).context("a CAN frame")?;
    Ok(timing.frame(&frame) + timing.intermission())
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.sum::<f64>() / count as f64
}
