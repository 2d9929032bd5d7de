//! A board on a debug probe of this computer, through the library probe-rs: an ST-LINK, a J-Link, a CMSIS-DAP.
//!
//! **No probe has been at the other end yet.** What runs above it is tested through [`gdb`](super::gdb).

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use probe_rs::flashing::{
    DownloadOptions, ElfLoader, ElfOptions, FlashProgress, ProgressEvent, ProgressOperation,
};
use probe_rs::probe::{DebugProbeSelector, list::Lister};
use probe_rs::{MemoryInterface, Permissions, Session};

use super::Target;
use crate::signing::Board;

/// A reset takes milliseconds.
const RESET: Duration = Duration::from_secs(1);
/// DBGMCU_IDC, whose low 12 bits name the device (RM0433 and RM0468, microcontroller debug unit).
const IDENTITY: u64 = 0x5C00_1000;
const DEVICE: u32 = 0xFFF;

/// The board's chip as probe-rs calls it, and its device identity.
const fn chip(board: Board) -> (&'static str, u32) {
    match board {
        Board::H743 => ("STM32H743ZITx", 0x450),
        Board::H723 => ("STM32H723ZGTx", 0x483),
    }
}

/// The probe, attached.
pub struct UsbProbe(Session);

impl UsbProbe {
    /// Attach to the chip of `board` through the probe of this name (`VID:PID` or `VID:PID:SERIAL`), or through the
    /// only one there is.
    pub fn attach(board: Board, name: Option<&str>) -> Result<Self> {
        let selector = name.map(DebugProbeSelector::try_from).transpose();
        let selector = selector.with_context(|| format!("--probe {}", name.unwrap_or_default()))?;
        let found = Lister::new().list(selector.as_ref());
        let probe = match found.as_slice() {
            [] => bail!(
                "no debug probe{}: is the board's ST-LINK connector (CN1) on USB, and may this user open it \
                 (https://probe.rs/docs/getting-started/probe-setup)?",
                name.map(|name| format!(" is {name}")).unwrap_or_default()
            ),
            [probe] => probe,
            several => {
                let names: Vec<_> = several.iter().map(ToString::to_string).collect();
                bail!("several debug probes, choose one by --probe: {}", names.join("; "))
            }
        };
        let (chip, device) = chip(board);
        let opened = probe.open().with_context(|| probe.to_string())?;
        let mut session = opened
            .attach(chip, Permissions::default())
            .with_context(|| format!("{probe}: cannot attach to an {chip}"))?;
        let found = session.core(0)?.read_word_32(IDENTITY)? & DEVICE;
        ensure!(
            found == device,
            "the chip's identity is {found:#05x}, that of an {chip} {device:#05x}: another --board?"
        );
        Ok(Self(session))
    }

    /// Write the program to flash, and read it back. `progress` gets the bytes written, and of how many.
    pub fn flash(&mut self, elf: &Path, mut progress: impl FnMut(u64, Option<u64>)) -> Result<()> {
        let mut options = DownloadOptions::default();
        options.verify = true;
        options.progress = FlashProgress::new(|event| match event {
            ProgressEvent::AddProgressBar { operation: ProgressOperation::Program, total } => {
                progress(0, total)
            }
            ProgressEvent::Progress { operation: ProgressOperation::Program, size, .. } => {
                progress(size, None)
            }
            _ => {}
        });
        let loader = ElfLoader(ElfOptions::default());
        probe_rs::flashing::download_file_with_options(&mut self.0, elf, loader, options)
            .with_context(|| format!("{}: cannot be written to flash", elf.display()))
    }
}

impl Target for UsbProbe {
    fn reset(&mut self) -> Result<()> {
        self.0.core(0)?.reset_and_halt(RESET)?;
        Ok(())
    }

    /// Memory is read and written beside the running core.
    fn run_for(&mut self, time: Duration) -> Result<()> {
        let mut core = self.0.core(0)?;
        if core.core_halted()? {
            core.run()?;
        }
        std::thread::sleep(time);
        Ok(())
    }

    fn read(&mut self, address: u32, words: &mut [u32]) -> Result<()> {
        Ok(self.0.core(0)?.read_32(address.into(), words)?)
    }

    fn write(&mut self, address: u32, words: &[u32]) -> Result<()> {
        Ok(self.0.core(0)?.write_32(address.into(), words)?)
    }
}
