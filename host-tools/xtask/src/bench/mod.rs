//! `cargo xtask bench`: what the signal path costs.

use anyhow::Result;
use clap::{Args, ValueEnum};

use crate::qemu::shipped_model;

mod compression;
mod cycles;
mod emulated;
mod host;
mod layouts;
pub mod inputs;
mod trace;

/// What to measure.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Instructions are counted in QEMU (machine mps2-an500, -icount) and exact: a loop of known length is measured \
first, every run measures the kernels again, and a difference is an error. They are not cycles; what is \
printed as cycles is an estimate by LLVM's model of the core, over all instructions of one frame.
What the firmware takes of flash, RAM and stack: cargo xtask stack.

Examples:
  cargo xtask bench                                 everything
  cargo xtask bench --only kernels                  seconds: the kernels alone, after a change to one
  cargo xtask bench --only path --frames 60         a frame from samples to CAN frames
  cargo xtask bench --only layouts                  the same for rows of slipsense reproduce that fit
  cargo xtask bench --only host                     frames per second here
  cargo xtask bench --only compression              raw frames on the bus")]
pub struct Options {
    /// Only these parts; may be given several times
    #[arg(long, value_name = "PART")]
    only: Vec<Part>,
    /// Frames to measure of each input, after those that fill the windows
    #[arg(long, default_value_t = 240, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
}

/// Replayed over all cores of this computer.
const REPLAYED_FRAMES: usize = 1_400_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Part {
    /// Instructions of every kernel
    Kernels,
    /// Instructions of a frame, from samples to CAN frames
    Path,
    /// Instructions of a frame for the rows of `slipsense reproduce` that fit the microcontroller
    Layouts,
    /// Estimate of the cycles of a frame
    Cycles,
    /// Frames per second on this computer
    Host,
    /// Raw frames compressed: length, load of a bus, instructions
    Compression,
}

pub fn run(options: &Options) -> Result<()> {
    let wanted = |part| options.only.is_empty() || options.only.contains(&part);
    let model = shipped_model()?;
    let frames = options.frames as usize;
    for part in Part::value_variants().iter().filter(|&&part| wanted(part)) {
        match part {
            // The path measures them too.
            Part::Kernels if wanted(Part::Path) => {}
            Part::Kernels => emulated::print(&model, 0)?,
            Part::Path => emulated::print(&model, frames)?,
            Part::Layouts => layouts::print(&model, frames)?,
            Part::Cycles => cycles::print(&model)?,
            Part::Host => host::print(&model, REPLAYED_FRAMES)?,
            Part::Compression => compression::print(&model, frames)?,
        }
    }
    Ok(())
}
