//! Developer commands, started as `cargo xtask`.

use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod cmsis;
mod elf;
mod process;
mod python;
mod qemu;
mod retrain;
mod stack;
mod table;
mod test;
mod toolchain;

/// Developer commands of SlipSense.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run everything that must pass: formatting, lints, host tests, ARM builds, emulator, Python checks
    Test(test::Options),
    /// Run frames on an emulated Cortex-M7 and compare every result with this computer's, bit for bit
    Qemu(qemu::Options),
    /// Measure: instructions on an emulated Cortex-M7, bytes of flash and RAM, frames per second here
    Bench(bench::Options),
    /// How deep the firmware's stack can get
    Stack(stack::Options),
    /// Make the library that the feature `cmsis-dsp` needs; prints the arguments that hand it to cargo
    Cmsis(cmsis::Options),
    /// Make the shipped model from nothing: train, quantize, choose the operating point
    Retrain(retrain::Options),
}

/// The repository.
fn root() -> &'static Path {
    // This package lies two folders below it.
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Test(options) => test::run(&options),
        Command::Qemu(options) => qemu::run(&options),
        Command::Bench(options) => bench::run(&options),
        Command::Stack(options) => stack::run(&options),
        Command::Cmsis(options) => cmsis::print(&options),
        Command::Retrain(options) => retrain::retrain(&options),
    };
    match result {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}
