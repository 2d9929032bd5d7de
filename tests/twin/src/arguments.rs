//! The command line.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use clap::Parser;

use crate::bench::DeskFault;
use crate::fault_injection::{self, Fault};
use crate::machine;
use crate::xl::Xl;

/// Run the firmware's ELF on an emulated STM32H743, and compare what it sends with the host.
#[derive(Debug, Parser)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin EPISODE.npz --xl icm42688               the firmware for that part, with the emulator's own model
  cargo xtask twin --seconds 3 --fault off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin EPISODE.npz --faults                    every fault in turn, and a table of flags and recovery
  cargo xtask twin --gdb 3333                              wait for a debugger on this port")]
pub struct Arguments {
    /// Episode that the sensor models play, over and over; none: no sensor is fitted.
    pub episode: Option<PathBuf>,
    /// The firmware.
    #[arg(long)]
    pub elf: PathBuf,
    /// A bootloader before it; none: the firmware starts itself, and takes no update of itself.
    #[arg(long)]
    pub boot: Option<PathBuf>,
    /// Virtual time to run, in seconds.
    #[arg(long, default_value_t = 1.0, value_parser = |text: &str| number(text, 0.001..=36_000.0))]
    pub seconds: f64,
    /// Write what is on the bus as a candump log.
    #[arg(long)]
    pub can: Option<PathBuf>,
    /// Print the firmware's log.
    #[arg(long)]
    pub rtt: bool,
    /// Sensors in use, as settings in flash say it; else the flash is blank, which means one.
    #[arg(long, requires = "episode", value_parser = clap::value_parser!(u8).range(1..=3))]
    pub sensors: Option<u8>,
    /// Accelerometer behind each array, for which the firmware must be built.
    #[arg(long, value_enum, default_value_t)]
    pub xl: Xl,
    /// What happens to bus and sensors, as NAME:FROM-TO in virtual seconds; more than once for more. Bus: off (no
    /// acknowledge), jam (every frame), errors1, errors10 (per cent of the frames), flood (another node's full
    /// frames), hostile (its requests to the board, which is locked then); sensors: xl-stops, xl-overrun (its FIFO; both the ADXL380's), adc-stuck.
    #[arg(long, value_parser = fault_injection::parse)]
    pub fault: Vec<Fault>,
    /// Every one of these faults in turn, at least once and repeated for --seconds; `off` and `jam` once, at the end. Fails
    /// where one does not show what it must, or does not end.
    #[arg(long, requires = "episode", conflicts_with_all = ["fault", "far_end"])]
    pub faults: bool,
    /// What comes in at HSE, Hz; 0: nothing.
    #[arg(long, default_value_t = machine::HSE_HZ)]
    pub hse_hz: u64,
    /// Another firmware than the board's: print its log, which must hold a line with this text; more than once for more.
    #[arg(long, value_name = "TEXT", conflicts_with_all = ["episode", "faults", "far_end"])]
    pub says: Vec<String>,
    /// Number of sensors on the desk, their pads pressed all over: what the bring-up program asks for.
    #[arg(long, conflicts_with_all = ["episode", "sensors", "faults"], value_parser = clap::value_parser!(u8).range(1..=3))]
    pub desk: Option<u8>,
    /// What is wrong there.
    #[arg(long, value_enum, requires = "desk")]
    pub desk_fault: Option<DeskFault>,
    /// Run every event of the taxel scan one by one, and check every access by the MPU: the same to the nanosecond,
    /// and many times slower.
    #[arg(long)]
    pub slow: bool,
    /// Write every frame of the bus with its virtual nanoseconds, and what the core did, to compare two runs.
    #[arg(long)]
    pub trace: Option<PathBuf>,
    /// Serve a debugger at this port of this computer, and wait for it before the first instruction.
    #[arg(long)]
    pub gdb: Option<u16>,
    /// Print a port of this computer, wait for a program there that is another node of the bus, and run until it goes.
    #[arg(long)]
    pub far_end: bool,
    /// Number of runs with one flipped bit in a register or in the RAM in use, and what a receiver then believes.
    #[arg(long, value_name = "RUNS", requires = "episode", conflicts_with_all = ["faults", "far_end", "desk"])]
    pub bit_flips: Option<usize>,
    /// File for their verdicts. Those that it has are not run again, so that a campaign can be stopped, or made longer.
    #[arg(long, value_name = "FILE", requires = "bit_flips")]
    pub results: Option<PathBuf>,
    /// Number of runs of the bootloader for each --slot, each with another one of its instructions skipped: it must never
    /// start the image. A large number skips each instruction, at its first and at its last time.
    #[arg(long, value_name = "RUNS", requires_all = ["boot", "slot"], conflicts_with_all = ["episode", "faults", "desk"])]
    pub boot_skips: Option<usize>,
    /// An image that must not be started, to lie in the slot of the firmware.
    #[arg(long, value_name = "IMAGE", requires = "boot_skips")]
    pub slot: Vec<PathBuf>,
    /// How often that program lets the watchdog restart the board; any other number fails the run.
    #[arg(long, requires = "far_end", default_value_t = 0)]
    pub bites: usize,
}

fn number(text: &str, range: RangeInclusive<f64>) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| range.contains(number));
    number.ok_or_else(|| format!("need a number from {} to {}", range.start(), range.end()))
}
