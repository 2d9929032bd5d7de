//! Developer commands, started as `cargo xtask`.

use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod board;
mod cmsis;
mod elf;
mod linux;
mod node;
mod process;
mod python;
mod qemu;
mod regions;
mod retrain;
mod ros2;
mod stack;
mod table;
mod test;
mod toolchain;
mod twin;

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
    /// Run the firmware's ELF on an emulated STM32H743 and compare what it sends with this computer's, bit for bit
    Twin(twin::Options),
    /// Boot Debian's kernel in QEMU and record, replay, watch and kill on its SocketCAN
    Linux(linux::Options),
    /// How deep the stack of each board's firmware can get, and what it takes of each memory
    Stack(stack::Options),
    /// Make the library that the feature `cmsis-dsp` needs; prints the arguments that hand it to cargo
    Cmsis(cmsis::Options),
    /// Build and run the ROS 2 node, and let ROS' own parser and another DDS look at what it says
    Ros2,
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
        Command::Twin(options) => twin::run(&options),
        Command::Linux(options) => linux::run(&options),
        Command::Stack(options) => stack::run(&options),
        Command::Cmsis(options) => cmsis::print(&options),
        Command::Ros2 => ros2::whole(),
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
