//! The board twin: the very ELF that is flashed, on an emulated STM32H743, in virtual time.
//!
//! The emulator is the crate rigless; ours are the FDCANs, the bus and its far end, the accelerometers and the taxel
//! arrays. `cargo xtask twin` builds and runs it.

mod adxl380;
mod arrays;
mod compare;
mod far_end;
mod fdcan;
mod machine;
mod programs;
mod report;
mod restarts;
mod rtt;
mod run;
mod steady;
mod supply;
mod tapped;
mod told;
mod trouble;
mod window;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Parser;

/// Run the firmware's ELF on an emulated STM32H743, and compare what it sends with the host.
#[derive(Debug, Parser)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin --seconds 3 --trouble off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin --gdb 3333                              wait for a debugger on this port")]
struct Arguments {
    /// Episode that the sensor models play; none: no sensor is fitted.
    episode: Option<PathBuf>,
    /// The firmware.
    #[arg(long)]
    elf: PathBuf,
    /// A bootloader before it; none: the firmware starts itself, and takes no update of itself.
    #[arg(long)]
    boot: Option<PathBuf>,
    /// Virtual time to run, in seconds.
    #[arg(long, default_value_t = 1.0, value_parser = seconds)]
    seconds: f64,
    /// Write what is on the bus as a candump log.
    #[arg(long)]
    can: Option<PathBuf>,
    /// Print the firmware's log.
    #[arg(long)]
    rtt: bool,
    /// Deviation of the accelerometers' oscillators, per cent.
    #[arg(long, default_value_t = 0.7, allow_negative_numbers = true)]
    xl_error: f64,
    /// What happens to bus and sensors, as NAME:FROM-TO in virtual seconds; more than once for more. Bus: off (no
    /// acknowledge), jam (every frame), errors1, errors10 (per cent of the frames), flood (another node's full
    /// frames); sensors: xl-stops, adc-stuck.
    #[arg(long, value_parser = trouble::parse)]
    trouble: Vec<trouble::Trouble>,
    /// Run every event of the taxel scan one by one, and check every access by the MPU: the same to the nanosecond,
    /// and many times slower.
    #[arg(long)]
    slow: bool,
    /// Write every frame of the bus with its virtual nanoseconds, and what the core did, to compare two runs.
    #[arg(long)]
    trace: Option<PathBuf>,
    /// Serve a debugger at this port of this computer, and wait for it before the first instruction.
    #[arg(long)]
    gdb: Option<u16>,
    /// Print a port of this computer, wait for a program there that is another node of the bus, and run until it goes.
    #[arg(long)]
    far_end: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds <= 36_000.0 => Ok(seconds),
        _ => Err("need a number above 0 and at most 36000".to_owned()),
    }
}

fn main() -> ExitCode {
    match real_main(&Arguments::parse()) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn real_main(arguments: &Arguments) -> Result<bool> {
    let episode = match &arguments.episode {
        Some(path) => Some(std::sync::Arc::new(slipsense_episode::Episode::read(path)?)),
        None => None,
    };
    let options = run::Options {
        seconds: arguments.seconds,
        boot: arguments.boot.clone(),
        episode: episode.clone(),
        xl_error: arguments.xl_error / 100.0,
        troubles: arguments.trouble.clone(),
        slow: arguments.slow,
        gdb: arguments.gdb,
        far_end: arguments.far_end,
    };
    let done = run::run(&arguments.elf, &options)?;
    if let Some(path) = &arguments.can {
        report::write_candump(path, &done.frames)
            .with_context(|| format!("{}: cannot write", path.display()))?;
    }
    if arguments.far_end {
        return Ok(report::print_far_end(&done));
    }
    if let Some(path) = &arguments.trace {
        report::write_trace(path, &done).with_context(|| format!("{}: cannot write", path.display()))?;
    }
    report::print(&done, episode.as_deref(), arguments)
}
