//! `cargo xtask qemu`: the same frames on the emulated microcontroller and here, compared bit for bit.

use std::fs;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use clap::Args;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense_qemu::OUTPUT_FILE;
use slipsense_qemu::input::MODEL_BYTES_MAX;
use slipsense_qemu::record::{Record, SignalPath};
use slipsense_recording::Episode;

use crate::process::root;
use crate::table::{Table, median_and_worst, thousands};
use crate::twin::machine::MODEL;

mod compare;
mod extreme;
pub mod frames;
pub mod machine;

use compare::{PARTS, compare};
use frames::Frames;
use machine::{Machine, folder};

/// What to run, on which model.
#[derive(Args, Clone, Debug, Default)]
#[command(after_help = "\
Builds the program of tests/qemu for the Cortex-M7, starts it in QEMU (machine mps2-an500), feeds it \
every frame through a file and compares what comes back with what the same library computes here: \
log-mel features, logits, class, flags, health and every byte of every CAN frame.

Exit code: 0 all equal, 1 something differs, 2 it could not be run.

Examples:
  cargo xtask qemu host-tools/cli/demo/episode.npz
  cargo xtask qemu --extreme --frames 2000
  cargo xtask qemu --extreme --random-model 7
  cargo xtask qemu host-tools/cli/demo/episode.npz --compress-raw")]
pub struct Options {
    /// Episode files (.npz), one run each
    #[arg(value_name = "EPISODE", required_unless_present = "extreme")]
    pub episodes: Vec<PathBuf>,
    /// Also run extreme generated input, once for each number of sensors
    #[arg(long)]
    pub extreme: bool,
    /// Frames to run: of each episode at most (default: all), of extreme input in total (default: 2000)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: Option<u32>,
    /// Instead of the shipped model: a random network of random shape, made from this seed
    #[arg(long, value_name = "SEED")]
    pub random_model: Option<u64>,
    /// Send the raw messages compressed (register slipsense.raw.compressed)
    #[arg(long)]
    pub compress_raw: bool,
}

const EXTREME_FRAMES: u32 = 2000;
/// Of the extreme input.
const SEED: u64 = 1;

pub fn shipped_model() -> Result<Vec<u8>> {
    fs::read(root().join(MODEL)).with_context(|| format!("{MODEL}: cannot read the model"))
}

impl Options {
    fn model(&self) -> Result<(String, Vec<u8>)> {
        let (name, bytes) = match self.random_model {
            Some(seed) => (format!("random {seed}"), extreme::model(seed)?),
            None => (MODEL.to_owned(), shipped_model()?),
        };
        let length = bytes.len();
        ensure!(
            length <= MODEL_BYTES_MAX,
            "{name}: {length} bytes, the emulated board takes {MODEL_BYTES_MAX}"
        );
        Model::parse(&bytes).with_context(|| format!("{name}: not a usable model"))?;
        Ok((name, bytes))
    }

    fn inputs(&self) -> Result<Vec<(String, Frames)>> {
        let mut inputs = Vec::new();
        for path in &self.episodes {
            let name = path.display().to_string();
            let frames = Frames::from_episode(&Episode::read(path)?, self.frames).context(name.clone())?;
            inputs.push((name, frames));
        }
        for sensors in (1..=MAX_SENSORS).filter(|_| self.extreme) {
            // The first runs take what does not divide evenly.
            let total = self.frames.unwrap_or(EXTREME_FRAMES) as usize;
            let count = (total + MAX_SENSORS - sensors) / MAX_SENSORS;
            let frames = extreme::frames(count as u32, sensors, SEED);
            inputs.push((format!("extreme input, {sensors} sensors"), frames));
        }
        inputs.retain(|(_, frames)| !frames.list.is_empty());
        Ok(inputs)
    }
}

/// Compare the kernels of the Cortex-M7 with the portable ones; fails where a call differs.
pub fn kernels() -> Result<()> {
    let text = Machine::build("slipsense-qemu-kernels")?.print()?;
    ensure!(
        text.contains("conv_relu_pool: 0 of"),
        "the emulated program did not compare the kernels:\n{text}"
    );
    print!("{text}");
    Ok(())
}

/// Run and report; `false` if something differed.
pub fn run(options: &Options) -> Result<bool> {
    let (model_name, model) = options.model()?;
    let machine = Machine::build("slipsense-qemu")?;
    let title = format!(
        "Frames that differ between this computer and the emulated Cortex-M7, by part; instructions of the pipeline \
         per frame, not cycles; model {model_name}"
    );
    let mut columns = vec!["input", "sensors", "frames", "CAN frames", "slip frames"];
    columns.extend(PARTS);
    columns.extend(["any", "instructions, median", "worst"]);
    let mut table = Table::new(title, &columns);
    let (mut differing, mut compared) = (0, 0);
    for (name, mut frames) in options.inputs()? {
        frames.compress_raw = options.compress_raw;
        eprintln!("{name}: {} frames on the emulated Cortex-M7", frames.list.len());
        let mut path = SignalPath::new(&frames.header(&model)?, Model::parse(&model)?)?;
        let here = |(stamp, parts): &(_, Vec<_>)| path.record(*stamp, parts, not_counted);
        let expected: Vec<Record> = frames.list.iter().map(here).collect();
        let records = emulate(&machine, &frames, &model)?;
        let comparison = compare(&expected, &records);
        comparison.first.iter().for_each(|mismatch| eprintln!("  {mismatch}"));
        let mut row = vec![name, frames.sensors.to_string()];
        let sizes = [records.len(), comparison.can_frames, comparison.slip_frames];
        row.extend(
            sizes.iter().chain(&comparison.by_part).chain([&comparison.frames]).map(ToString::to_string),
        );
        row.extend(
            median_and_worst(records.iter().map(|record| record.instructions).collect()).map(thousands),
        );
        table.row(row);
        differing += comparison.frames;
        compared += records.len();
    }
    print!("{table}");
    println!("{differing} mismatching frames of {compared}");
    Ok(differing == 0)
}

/// Instructions are the emulator's to count.
fn not_counted(work: &mut dyn FnMut()) -> u32 {
    work();
    0
}

fn emulate(machine: &Machine, frames: &Frames, model: &[u8]) -> Result<Vec<Record>> {
    let dir = folder(frames, model)?;
    let start = Instant::now();
    machine.run(dir.path())?;
    eprintln!("  {:.1} s", start.elapsed().as_secs_f64());
    let bytes = fs::read(dir.path().join(OUTPUT_FILE)).context("the emulated program wrote no output")?;
    let mut rest = &bytes[..];
    let mut records = Vec::new();
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        let record = Record::decode(&mut rest);
        records.push(record.with_context(|| format!("no record at byte {at} of the output"))?);
    }
    let (written, all) = (records.len(), frames.list.len());
    ensure!(written == all, "the emulated program wrote {written} records of {all} frames");
    Ok(records)
}
