//! Developer commands, started as `cargo xtask`.

use std::process::ExitCode;

use clap::{Parser, Subcommand};

mod bench;
mod cmsis;
mod elf;
mod firmware;
mod front_end;
mod fuzz;
#[cfg(test)]
mod imports;
mod linux;
mod package;
mod process;
mod qemu;
mod regions;
mod release;
mod retrain;
mod ros2;
mod stack;
mod table;
mod test;
mod toolchain;
mod twin;
mod web;

/// Developer commands of SlipSense.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask")]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Run what must pass: formatting, lints, host tests, firmware, emulated Cortex-M7; `test all` runs every check
    Test(test::Options),
    /// Run frames on an emulated Cortex-M7 and compare every result with this computer's, bit for bit
    Qemu(qemu::Options),
    /// Measure: instructions on an emulated Cortex-M7, frames per second here, compression of raw frames
    Bench(bench::Options),
    /// Run the firmware's ELF on an emulated STM32H743 and compare what it sends with this computer's, bit for bit
    Twin(twin::Options),
    /// Boot Debian's kernel in QEMU and record, replay, watch and kill on its SocketCAN
    Linux(linux::Options),
    /// How deep the stack of the firmware can get, and what it takes of each memory
    Stack(stack::Options),
    /// Make the library that the feature `cmsis-dsp` needs; prints the arguments that hand it to cargo
    #[command(after_help = cmsis::HELP)]
    Cmsis,
    /// Check the analog front end: schematic, simulation, the generator's model of it
    FrontEnd(front_end::Options),
    /// Mutated input for every parser, chosen by libFuzzer
    Fuzz(fuzz::Options),
    /// Build and run the ROS 2 node; ROS' own parser and another DDS check its messages
    Ros2,
    /// Let lerobot write our episodes as a data set and read them; downloads 3 GB, PyTorch
    Lerobot,
    Release(release::Options),
    /// Make the live page as one file that needs no server: the pipeline in it as WebAssembly
    Web(web::Options),
    /// Make the shipped model from nothing: train, quantize, choose the operating point
    Retrain(retrain::Options),
}

fn main() -> ExitCode {
    let result = match Cli::parse().command {
        Command::Test(options) => test::run(&options),
        Command::Qemu(options) => qemu::run(&options),
        Command::Bench(options) => bench::run(&options).map(|()| true),
        Command::Twin(options) => twin::run(&options),
        Command::Linux(options) => linux::run(&options),
        Command::Stack(options) => stack::run(&options),
        Command::Cmsis => cmsis::print().map(|()| true),
        Command::FrontEnd(options) => front_end::check(&options).map(|()| true),
        Command::Fuzz(options) => fuzz::run(&options),
        Command::Ros2 => ros2::whole().map(|()| true),
        Command::Lerobot => package::lerobot().map(|()| true),
        Command::Release(options) => release::make(&options).map(|()| true),
        Command::Web(options) => web::make(&options).map(|()| true),
        Command::Retrain(options) => retrain::retrain(&options).map(|()| true),
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
