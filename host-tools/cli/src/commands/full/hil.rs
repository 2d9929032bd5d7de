//! `slipsense hil`: an episode into a board, and every CAN frame of its answers beside this computer's.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result};
use slipsense_recording::Episode;

use super::{ModelArg, Print};
use crate::hil::gdb::GdbServer;
use crate::hil::replay::{Difference, Report, Run, replay};
use crate::hil::{Target, mailbox};

/// Replay an episode into a board over its debug probe, and compare every CAN frame with this computer's
///
/// The hardware-in-the-loop test. The board runs the program slipsense-hil: the firmware's clocks, memories, tasks and
/// pipeline, with a mailbox in RAM in place of sensors and bus, so that a bare NUCLEO on its USB cable is enough. This
/// command leaves a frame there, waits, and compares all bytes of all CAN frames that the board makes of it with what
/// the same code makes of it here. The board's program answers frames on an emulated STM32H743; it has not yet run on
/// hardware.
///
/// With --probe it writes the program to the board's flash through a debug probe on USB, such as a NUCLEO's own
/// ST-LINK, checks it, and goes on. That needs the feature `hil`, whose drivers of probes take minutes to build; no
/// probe has been at the other end yet. With --gdb a GDB server stands between, such as OpenOCD's, and the program is
/// in flash already.
#[derive(clap::Args)]
#[command(
    group(clap::ArgGroup::new("way").args(["probe", "gdb"]).required(true)),
    after_help = "\
Exit code: 0 all equal, 1 something differs, 2 it could not be run.

Examples:
  cargo build-hil-h743                             the program, for a NUCLEO-H743ZI2
  cargo run --release --features hil -- hil grasp.npz --probe
                                                   flash it, replay, compare
  cargo run --release --features hil -- hil grasp.npz --probe=0483:374e

  openocd -f interface/stlink.cfg -f target/stm32h7x.cfg \\
      -c 'program target/thumbv7em-none-eabihf/firmware/slipsense-hil verify'
                                                   flash it, and serve a debugger; in another terminal
  slipsense hil grasp.npz --gdb localhost:3333     replay, compare
  slipsense hil grasp.npz --gdb localhost:3333 --frames 500 --json"
)]
pub struct Args {
    /// Episode to replay, an .npz file
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// The program on the board, as `cargo build-hil-h743` leaves it
    #[arg(long, value_name = "FILE", default_value = "target/thumbv7em-none-eabihf/firmware/slipsense-hil")]
    elf: PathBuf,
    /// Flash the board on this debug probe, or on the only one there is
    #[arg(long, value_name = "VID:PID[:SERIAL]", num_args = 0..=1, require_equals = true)]
    probe: Option<Option<String>>,
    /// A GDB server with the board behind it, and the program in its flash
    #[arg(long, value_name = "HOST:PORT")]
    gdb: Option<String>,
    #[command(flatten)]
    model: ModelArg,
    /// Frames to replay at most
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    frames: Option<u32>,
    /// Seconds that the board may take to start, and for a frame
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..=3600))]
    timeout_s: u64,
    #[command(flatten)]
    print: Print,
}

/// Exit code where board and computer differ.
const EXIT_DIFFERENT: i32 = 1;

impl Args {
    pub fn run(self) -> Result<()> {
        let mailbox = mailbox(&self.elf)?;
        let model = self.model.read()?;
        let model = model.parse()?;
        let episode = Episode::read(&self.episode)?;
        let frames = self.frames.map_or(usize::MAX, |frames| frames as usize).min(episode.frames());
        let timeout = Duration::from_secs(self.timeout_s);
        let mut target: Box<dyn Target> = match &self.gdb {
            Some(address) => Box::new(GdbServer::connect(address, timeout)?),
            None => self.probe(self.probe.as_ref().and_then(Option::as_deref))?,
        };
        let name = self.episode.display().to_string();
        let run = Run { mailbox, name, episode: &episode, frames, model, timeout };
        let report = self.print.progress(frames, "frames", |bar| replay(&mut *target, &run, || bar.inc(1)));
        let report = report.context(run.name)?;
        drop(target);
        self.print.show(&report, || text(&report))?;
        if report.differing_frames > 0 {
            std::process::exit(EXIT_DIFFERENT);
        }
        Ok(())
    }

    #[cfg(feature = "hil")]
    fn probe(&self, name: Option<&str>) -> Result<Box<dyn Target>> {
        let mut probe = crate::hil::probe::UsbProbe::attach(&Default::default(), name)?;
        self.print.progress(0, "bytes to flash", |bar| {
            probe.flash(&self.elf, |bytes, of| {
                of.into_iter().for_each(|of| bar.inc_length(of));
                bar.inc(bytes);
            })
        })?;
        Ok(Box::new(probe))
    }

    #[cfg(not(feature = "hil"))]
    fn probe(&self, name: Option<&str>) -> Result<Box<dyn Target>> {
        anyhow::bail!(
            "--probe{}: this build has no drivers of debug probes: `cargo run --release --features hil -- hil {} \
             --probe` has them; or name a GDB server by --gdb",
            name.map(|name| format!("={name}")).unwrap_or_default(),
            self.episode.display()
        )
    }
}

fn text(report: &Report) -> String {
    let mut text = String::new();
    for Difference { frame, can_frame, expected, found } in &report.first {
        let side = |can: &Option<String>| can.clone().unwrap_or_else(|| "none".to_owned());
        let (board, here) = (side(found), side(expected));
        text += &format!("frame {frame}, CAN frame {can_frame}: board {board}, here {here}\n");
    }
    let Report { episode, sensors, frames, differing_frames, can_frames, .. } = report;
    let Report { worst_step_cycles, worst_step_frame, worst_step_us, core_hz, .. } = report;
    text + &format!(
        "{episode}: {} of {frames} frames equal, {differing_frames} differ; {can_frames} CAN frames of {sensors} \
         sensors compared\n\
         pipeline: {worst_step_cycles} cycles at most, in frame {worst_step_frame}: {worst_step_us:.1} us at \
         {core_hz} Hz, by the board's own counter\n",
        frames - differing_frames
    )
}
