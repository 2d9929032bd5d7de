//! The board twin: the very ELF that is flashed, on an emulated STM32H743, in virtual time.
//!
//! The emulator is the crate rigless; ours are the FDCANs, the watchdog, the bus
//! and its far end, the ADXL380s and the taxel arrays. `cargo xtask twin` builds and runs it.

mod shared;
mod adxl380;
mod arguments;
mod array_taps;
mod bench;
mod arrays;
mod board_faults;
mod campaign;
mod compare;
mod far_end;
mod fault_schedule;
mod fdcan;
mod fitted;
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
mod xl;

use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use arguments::Arguments;
use bench::Desk;
use clap::Parser;
use fault_injection::{Fault, Faults, Kind};
use fitted::Fitted;
use slipsense_recording::Episode;
use xl::Xl;

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

/// What the sensors play: the file's, but for samples that the part cannot give.
fn read(path: &Path, xl: Xl) -> Result<Arc<Episode>> {
    let mut episode = Episode::read(path)?;
    for axis in episode.xl.iter_mut().flatten().flatten() {
        *axis = (*axis).max(xl.least());
    }
    Ok(Arc::new(episode))
}

fn real_main(arguments: &Arguments) -> Result<bool> {
    let faults =
        if arguments.faults { fault_schedule::schedule(arguments.seconds) } else { arguments.fault.clone() };
    let of_adxl380 = |fault: &&Fault| matches!(fault.kind, Kind::AccelerometerStops | Kind::FifoOverrun);
    if let (Xl::Icm42688, Some(fault)) = (arguments.xl, faults.iter().find(of_adxl380)) {
        bail!("{}: a fault of the ADXL380's; the emulator's ICM-42688-P has none", fault.name);
    }
    let episode = arguments.episode.as_deref().map(|path| read(path, arguments.xl)).transpose()?;
    if let (Some(sensors), Some(episode)) = (arguments.sensors, &episode)
        && usize::from(sensors) > episode.sensors
    {
        bail!("--sensors {sensors}: the episode has {}", episode.sensors);
    }
    let seconds = if arguments.faults { fault_schedule::seconds(&faults) } else { arguments.seconds };
    let desk = arguments.desk.map(|sensors| Desk { sensors: sensors.into(), fault: arguments.desk_fault });
    let Arguments { xl, slow, hse_hz, .. } = *arguments;
    let fitted = Arc::new(Fitted { episode, desk, xl, faults: Faults::new(faults), slow, hse_hz });
    if let Some(count) = arguments.bit_flips {
        return campaign::bit_flips::run(arguments, &fitted, count);
    }
    if let Some(count) = arguments.boot_skips {
        return campaign::boot_skips::run(arguments, &fitted, count);
    }
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
    report::print(&done, &fitted, arguments)
}
