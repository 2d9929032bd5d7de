//! `cargo xtask bench`: what the signal path costs, every number with what it is.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};

use crate::board::Board;
use crate::qemu::default_model;
use crate::stack;

mod compression;
mod cycles;
mod emulated;
mod host;
mod inputs;
mod loops;
mod mca;
mod other_coders;
mod report;
mod size;
mod trace;

use report::Report;

/// What to measure.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Instructions are counted in QEMU (machine mps2-an500, -icount) and exact: a loop of known length is measured \
first, every run measures the kernels again, and a difference is an error. They are not cycles; what is \
printed as cycles is an estimate by LLVM's model of the core, over all instructions of one frame.

Examples:
  cargo xtask bench                                 everything
  cargo xtask bench --only kernels                  seconds: the kernels alone, after a change to one
  cargo xtask bench --only cycles --only size       what the firmware's code and its loops take
  cargo xtask bench --only path --frames 60 --json  the whole path, for a machine
  cargo xtask bench --only host --tract             frames per second here, beside the float network on tract
  cargo xtask bench --only compression              raw frames on the bus, beside zstd and others
  cargo xtask bench --out out/bench                 writes bench.json and bench.md")]
pub struct Options {
    /// Only these parts; may be given several times
    #[arg(long, value_name = "PART")]
    only: Vec<Part>,
    /// Frames to measure of each input, after those that fill the windows
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Model file
    #[arg(long, default_value_os_t = default_model(), hide_default_value = true)]
    model: PathBuf,
    /// Frames to replay over all cores of this computer
    #[arg(long, value_name = "FRAMES", default_value_t = 1_400_000)]
    replay: u32,
    /// Also the float network on tract on this computer: needs a tensor library, minutes to build
    #[arg(long)]
    tract: bool,
    /// Print one JSON object on standard output instead of tables
    #[arg(long)]
    json: bool,
    /// Write bench.json and bench.md into this folder
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

/// A part of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Instructions of every kernel
    Kernels,
    /// Instructions of a frame, from samples to CAN frames
    Path,
    /// Estimate of the cycles of a frame, by function, and of the network's inner loops
    Cycles,
    /// Flash and RAM of the firmware
    Size,
    /// Bound of the firmware's stack
    Stack,
    /// Frames per second on this computer
    Host,
    /// Raw frames compressed: length beside other coders, load of a bus, instructions
    Compression,
}

/// Measure and print.
pub fn run(options: &Options) -> Result<bool> {
    let wanted = |part| options.only.is_empty() || options.only.contains(&part);
    let model = std::fs::read(&options.model)
        .with_context(|| format!("{}: cannot read the model", options.model.display()))?;
    let mut report = Report::default();
    if wanted(Part::Kernels) || wanted(Part::Path) {
        let frames = if wanted(Part::Path) { options.frames as usize } else { 0 };
        report.emulated = Some(emulated::measure(&model, frames)?);
    }
    if wanted(Part::Cycles) || wanted(Part::Size) || wanted(Part::Stack) {
        let firmware = Board::H743.build()?;
        if wanted(Part::Cycles) {
            report.cycles = Some(cycles::estimate(&firmware, &model)?);
        }
        if wanted(Part::Size) {
            report.size = Some(size::measure(&firmware, &model)?);
        }
        if wanted(Part::Stack) {
            report.stack = Some(stack::measure(Board::H743, Some(firmware))?);
        }
    }
    if wanted(Part::Host) {
        report.host = Some(host::measure(&model, options.replay as usize, options.tract)?);
    }
    if wanted(Part::Compression) {
        report.compression = Some(compression::measure(&model, options.frames as usize)?);
    }
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{report}");
    }
    if let Some(dir) = &options.out {
        report.write(dir)?;
    }
    Ok(true)
}
