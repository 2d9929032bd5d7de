//! A board on a debug probe of this computer, through the library probe-rs: an ST-LINK, a J-Link, a CMSIS-DAP.
//!
//! The probe is chosen, attached to the chip, the chip's identity is read, and only then is anything written. **No
//! probe has been at the other end yet**: what is above probe-rs runs in `tests/hil_probe.rs` with a probe that is a
//! program.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use probe_rs::flashing::{
    DownloadOptions, ElfLoader, ElfOptions, FlashProgress, ProgressEvent, ProgressOperation,
};
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem};
use probe_rs::probe::{DebugProbeInfo, DebugProbeSelector};
use probe_rs::{MemoryInterface, Permissions, Session};

use super::Target;

/// A reset takes milliseconds.
const RESET: Duration = Duration::from_secs(1);
/// DBGMCU_IDC, whose low 12 bits name the device (RM0433, microcontroller debug unit).
const IDENTITY: u64 = 0x5C00_1000;
const DEVICE: u32 = 0xFFF;
/// What lets a user open a probe on Linux.
const RULES: &str = "https://probe.rs/docs/getting-started/probe-setup";

/// The board's chip as probe-rs calls it.
const CHIP: &str = "STM32H743ZITx";
/// Its device identity.
const CHIP_DEVICE: u32 = 0x450;

/// The probe, attached.
pub struct UsbProbe {
    session: Session,
    /// It was let run since the last reset.
    is_running: bool,
}

impl UsbProbe {
    /// Attach to the board's chip through the probe of this name (`VID:PID` or `VID:PID:SERIAL`), or through the
    /// only one that `lister` knows. A chip of another identity is an error, and is left as it is.
    pub fn attach(lister: &Lister, name: Option<&str>) -> Result<Self> {
        let probe = choose(lister, name)?;
        let opened = lister.open(&probe).with_context(|| {
            format!("{probe}: cannot be opened: does another program, a debugger or OpenOCD, have it?")
        })?;
        let attached = opened.attach(CHIP, Permissions::default());
        let mut session = attached.with_context(|| {
            format!(
                "{probe}: no {CHIP} answers: is the board powered, and are its debug wires on this probe?"
            )
        })?;
        let identity = session.core(0).and_then(|mut core| core.read_word_32(IDENTITY));
        let found = identity.with_context(|| format!("{probe}: cannot read the chip's identity"))? & DEVICE;
        ensure!(
            found == CHIP_DEVICE,
            "{probe}: the chip's identity is {found:#05x}, that of an {CHIP} is {CHIP_DEVICE:#05x}; nothing was \
             written to it"
        );
        Ok(Self { session, is_running: false })
    }

    /// Write the program to flash, where it is not there yet, and read it back. `progress` gets the bytes written, and
    /// of how many.
    pub fn flash(&mut self, elf: &Path, mut progress: impl FnMut(u64, Option<u64>)) -> Result<()> {
        let mut options = DownloadOptions::default();
        // Flash wears, and most runs have the same program.
        options.preverify = true;
        options.verify = true;
        options.progress = FlashProgress::new(|event| match event {
            ProgressEvent::AddProgressBar { operation: ProgressOperation::Program, total } => {
                progress(0, total);
            }
            ProgressEvent::Progress { operation: ProgressOperation::Program, size, .. } => {
                progress(size, None);
            }
            _ => {}
        });
        let loader = ElfLoader(ElfOptions::default());
        probe_rs::flashing::download_file_with_options(&mut self.session, elf, loader, options)
            .with_context(|| format!("{}: cannot be written to flash", elf.display()))
    }
}

/// The probe of this name, or the only one.
fn choose(lister: &Lister, name: Option<&str>) -> Result<DebugProbeInfo> {
    let selector = name.map(str::parse::<DebugProbeSelector>).transpose();
    let selector = selector.with_context(|| {
        format!("--probe={}: must be VID:PID or VID:PID:SERIAL", name.unwrap_or_default())
    })?;
    let mut found = lister.list_with_access(selector.as_ref());
    let ProbeListItem { info, accessibility } = match (found.pop(), found.as_slice()) {
        (Some(only), []) => only,
        (None, _) => bail!(
            "--probe{}: no such debug probe is there: is the board's ST-LINK connector (CN1) on USB, and does the \
             cable carry data?",
            name.map(|name| format!("={name}")).unwrap_or_default()
        ),
        (Some(last), others) => {
            let names: Vec<_> = others.iter().chain([&last]).map(|item| item.info.to_string()).collect();
            bail!("--probe: {} debug probes, choose one by VID:PID:SERIAL: {}", names.len(), names.join("; "))
        }
    };
    ensure!(
        accessibility == Accessibility::Accessible,
        "{info}: this user may not open it: install probe-rs' udev rule ({RULES}) and plug it in again"
    );
    Ok(info)
}

impl Target for UsbProbe {
    fn reset(&mut self) -> Result<()> {
        let halted = self.session.core(0).and_then(|mut core| core.reset_and_halt(RESET));
        self.is_running = false;
        halted.map(|_| ()).context("the board cannot be reset")
    }

    /// Memory is read and written beside the running core.
    fn run_for(&mut self, time: Duration) -> Result<()> {
        let mut core = self.session.core(0).context("the board's core does not answer")?;
        if self.is_running {
            let halted = core.core_halted().context("the board's core does not answer")?;
            ensure!(!halted, "the board's core has stopped by itself");
        } else {
            core.run().context("the board's core cannot be let run")?;
            self.is_running = true;
        }
        std::thread::sleep(time);
        Ok(())
    }

    fn read(&mut self, address: u32, words: &mut [u32]) -> Result<()> {
        let read = self.session.core(0).and_then(|mut core| core.read_32(address.into(), words));
        read.with_context(|| format!("{} words at {address:#010x} cannot be read", words.len()))
    }

    fn write(&mut self, address: u32, words: &[u32]) -> Result<()> {
        let written = self.session.core(0).and_then(|mut core| core.write_32(address.into(), words));
        written.with_context(|| format!("{} words at {address:#010x} cannot be written", words.len()))
    }
}
