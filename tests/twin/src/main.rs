//! The board twin: the very ELF that is flashed, on an emulated STM32H743, in virtual time.
//!
//! The emulator is the crate rigless; ours are the FDCANs, the watchdog, the bus
//! and its far end, the ADXL380s and the taxel arrays. `cargo xtask twin` builds and runs it.

mod adxl380;
mod array_taps;
mod bench;
mod arrays;
mod board_faults;
mod compare;
mod far_end;
mod fault_schedule;
mod fdcan;
mod flash_wait;
mod icm42688;
mod iwdg;
mod machine;
mod programs;
mod recovery;
mod report;
mod restarts;
mod rtt;
mod run;
mod settings;
mod scan_fast_path;
mod scan_timing;
mod power_faults;
mod bus_tap;
mod diagnostics;
mod fault_injection;
mod window;
mod xl;

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use bench::{Desk, DeskFault};
use clap::Parser;
use fault_injection::{Fault, Kind};
use machine::Fitted;
use slipsense_recording::Episode;
use xl::Xl;

/// Of an ADXL380's oscillator, if nothing else is asked for.
const XL_ERROR_PERCENT: f64 = 0.7;

/// Run the firmware's ELF on an emulated STM32H743, and compare what it sends with the host.
#[derive(Debug, Parser)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin EPISODE.npz --xl icm42688               the firmware for that part, with the emulator's own model
  cargo xtask twin --seconds 3 --fault off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin EPISODE.npz --faults                    every fault in turn, and a table of flags and recovery
  cargo xtask twin --gdb 3333                              wait for a debugger on this port")]
struct Arguments {
    /// Episode that the sensor models play, over and over; none: no sensor is fitted.
    episode: Option<PathBuf>,
    /// The firmware.
    #[arg(long)]
    elf: PathBuf,
    /// A bootloader before it; none: the firmware starts itself, and takes no update of itself.
    #[arg(long, requires = "far_end")]
    boot: Option<PathBuf>,
    /// Virtual time to run, in seconds.
    #[arg(long, default_value_t = 1.0, value_parser = |text: &str| number(text, 0.001..=36_000.0))]
    seconds: f64,
    /// Write what is on the bus as a candump log.
    #[arg(long)]
    can: Option<PathBuf>,
    /// Print the firmware's log.
    #[arg(long)]
    rtt: bool,
    /// Sensors in use, as settings in flash say it; else the flash is blank, which means one.
    #[arg(long, requires = "episode", value_parser = clap::value_parser!(u8).range(1..=3))]
    sensors: Option<u8>,
    /// Accelerometer behind each array, for which the firmware must be built.
    #[arg(long, value_enum, default_value_t)]
    xl: Xl,
    /// Deviation of the ADXL380s' oscillators, per cent, 0.7 if not given. The emulator's ICM-42688-P has none.
    #[arg(long, allow_negative_numbers = true, value_parser = |text: &str| number(text, -50.0..=50.0))]
    xl_error: Option<f64>,
    /// What happens to bus and sensors, as NAME:FROM-TO in virtual seconds; more than once for more. Bus: off (no
    /// acknowledge), jam (every frame), errors1, errors10 (per cent of the frames), flood (another node's full
    /// frames); sensors: xl-stops, xl-overrun (its FIFO; both the ADXL380's), adc-stuck.
    #[arg(long, value_parser = fault_injection::parse)]
    fault: Vec<Fault>,
    /// Every one of these faults in turn; fails where one does not show what it must, or does not end.
    #[arg(long, requires = "episode", conflicts_with_all = ["fault", "seconds", "far_end"])]
    faults: bool,
    /// What comes in at HSE, Hz; 0: nothing.
    #[arg(long, default_value_t = machine::HSE_HZ)]
    hse_hz: u64,
    /// Another firmware than the board's: print its log, which must hold a line with this text; more than once for more.
    #[arg(long, value_name = "TEXT", conflicts_with_all = ["episode", "faults", "far_end"])]
    says: Vec<String>,
    /// So many sensors lie on the desk, their pads pressed all over: what the bring-up program asks for.
    #[arg(long, conflicts_with_all = ["episode", "sensors", "faults"], value_parser = clap::value_parser!(u8).range(1..=3))]
    desk: Option<u8>,
    /// What is wrong there.
    #[arg(long, value_enum, requires = "desk")]
    desk_fault: Option<DeskFault>,
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
    /// How often that program lets the watchdog restart the board; any other number fails the run.
    #[arg(long, requires = "far_end", default_value_t = 0)]
    bites: usize,
}

fn number(text: &str, range: RangeInclusive<f64>) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| format!("need a number from {} to {}", range.start(), range.end()))
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

/// What the emulator's model of the ICM-42688-P cannot do.
fn check_xl(arguments: &Arguments, faults: &[Fault]) -> Result<()> {
    if arguments.xl != Xl::Icm42688 {
        return Ok(());
    }
    if arguments.xl_error.is_some() {
        bail!("--xl-error: the emulator's ICM-42688-P has no oscillator of its own");
    }
    let ours = |fault: &&Fault| matches!(fault.kind, Kind::AccelerometerStops | Kind::FifoOverrun);
    match faults.iter().find(ours) {
        Some(fault) => {
            bail!("{}: a fault of the ADXL380's; the emulator's ICM-42688-P has none", fault.name)
        }
        None => Ok(()),
    }
}

/// What the sensors play: the file's, but for samples that the part cannot give.
fn read(path: &Path, xl: Xl) -> Result<Arc<Episode>> {
    let mut episode = Episode::read(path)?;
    for axis in episode.xl.iter_mut().flatten().flatten() {
        *axis = (*axis).max(xl.least());
    }
    Ok(Arc::new(episode))
}

fn real_main(arguments: &Arguments) -> Result<bool> {
    let faults = if arguments.faults { fault_schedule::schedule() } else { arguments.fault.clone() };
    check_xl(arguments, &faults)?;
    let episode = arguments.episode.as_deref().map(|path| read(path, arguments.xl)).transpose()?;
    if let (Some(sensors), Some(episode)) = (arguments.sensors, &episode)
        && usize::from(sensors) > episode.sensors
    {
        bail!("--sensors {sensors}: the episode has {}", episode.sensors);
    }
    let seconds = if arguments.faults { fault_schedule::seconds(&faults) } else { arguments.seconds };
    let fitted = Fitted {
        episode: episode.clone(),
        desk: arguments.desk.map(|sensors| Desk { sensors: sensors.into(), fault: arguments.desk_fault }),
        xl: arguments.xl,
        xl_error: arguments.xl_error.unwrap_or(XL_ERROR_PERCENT) / 100.0,
        faults: faults.clone(),
        slow: arguments.slow,
        hse_hz: arguments.hse_hz,
    };
    let done = run::run(arguments, &fitted, seconds)?;
    if let Some(path) = &arguments.can {
        report::write_candump(path, &done.frames)
            .with_context(|| format!("{}: cannot write", path.display()))?;
    }
    if arguments.far_end {
        return Ok(report::print_far_end(&done, arguments.bites));
    }
    if let Some(path) = &arguments.trace {
        report::write_trace(path, &done).with_context(|| format!("{}: cannot write", path.display()))?;
    }
    if !arguments.says.is_empty() {
        return Ok(report::print_other(&done, &arguments.says));
    }
    report::print(&done, episode.as_deref(), &faults, arguments)
}
