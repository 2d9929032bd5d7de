//! A board on a debug probe of this computer, through the library probe-rs: an ST-LINK, a J-Link, a CMSIS-DAP.
//!
//! The probe is chosen, attached to the chip, the chip's identity is read, and only then is anything written. **No
//! probe has been at the other end yet**: the tests run what is above probe-rs with a simulated probe.

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

/// The board's chip as probe-rs calls it, and its device identity.
const CHIP: (&str, u32) = ("STM32H743ZITx", 0x450);

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
        let (chip, device) = CHIP;
        let opened = lister.open(&probe).with_context(|| {
            format!("{probe}: cannot be opened: does another program, a debugger or OpenOCD, have it?")
        })?;
        let attached = opened.attach(chip, Permissions::default());
        let mut session = attached.with_context(|| {
            format!(
                "{probe}: no {chip} answers: is the board powered, and are its debug wires on this probe?"
            )
        })?;
        let identity = session.core(0).and_then(|mut core| core.read_word_32(IDENTITY));
        let found = identity.with_context(|| format!("{probe}: cannot read the chip's identity"))? & DEVICE;
        ensure!(
            found == device,
            "{probe}: the chip's identity is {found:#05x}, that of an {chip} is {device:#05x}; nothing was written to it"
        );
        Ok(Self { session, is_running: false })
    }

    /// Write the program to flash where it is not there yet, and read it back. `progress`: bytes, and of how many.
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

/// With probes that are a list and a chip that is probe-rs' mock of a core: its memory is zeros.
#[cfg(test)]
mod tests {
    use super::*;

    use probe_rs::integration::FakeProbe;
    use probe_rs::probe::list::ProbeLister;
    use probe_rs::probe::stlink::StLinkFactory;
    use probe_rs::probe::{DebugProbeError, Probe, ProbeCreationError};

    /// A NUCLEO's ST-LINK, and its serial numbers.
    const VENDOR: u16 = 0x0483;
    const PRODUCT: u16 = 0x374E;

    /// Probes by their serial numbers, all with a core without a chip's identity.
    #[derive(Debug)]
    struct Probes {
        serials: Vec<&'static str>,
        accessibility: Accessibility,
        /// Somebody else has them.
        is_busy: bool,
    }

    impl ProbeLister for Probes {
        fn open(&self, selector: &DebugProbeSelector) -> Result<Probe, DebugProbeError> {
            assert!(self.accessibility == Accessibility::Accessible, "opened without being allowed to");
            assert_eq!((selector.vendor_id, selector.product_id), (VENDOR, PRODUCT));
            match self.is_busy {
                true => Err(ProbeCreationError::CouldNotOpen.into()),
                false => Ok(FakeProbe::with_mocked_core().into_probe()),
            }
        }

        fn list_with_access(&self, selector: Option<&DebugProbeSelector>) -> Vec<ProbeListItem> {
            let info = |serial: &&str| {
                let serial = Some((*serial).to_owned());
                DebugProbeInfo::new("STLink V3", VENDOR, PRODUCT, serial, &StLinkFactory, None, false)
            };
            let infos = self.serials.iter().map(info);
            let wanted = infos.filter(|info| selector.is_none_or(|selector| selector.matches_probe(info)));
            wanted.map(|info| ProbeListItem { info, accessibility: self.accessibility }).collect()
        }
    }

    fn probes(serials: &[&'static str]) -> Probes {
        Probes { serials: serials.to_vec(), accessibility: Accessibility::Accessible, is_busy: false }
    }

    /// The error, on one line, begins and ends with these words and has those between.
    #[track_caller]
    fn refused(probes: Probes, name: Option<&str>, begin: &str, between: &[&str], end: &str) {
        let attached = UsbProbe::attach(&Lister::with_lister(Box::new(probes)), name);
        let error = format!("{:#}", attached.err().expect("no chip of ours is there"));
        assert!(!error.contains('\n') && error.starts_with(begin) && error.ends_with(end), "{error}");
        assert!(between.iter().all(|words| error.contains(words)), "{error}");
    }

    #[test]
    fn a_probe_that_is_not_there_or_not_the_only_one() {
        refused(probes(&[]), None, "--probe: no such debug probe is there: is the board's ST-LINK", &[], "");
        let (no_such, other) = ("--probe=0483:374e:0035: no such debug probe is there", "0483:374e:0035");
        refused(probes(&["0034"]), Some(other), no_such, &[], "");
        let choose = "--probe: 2 debug probes, choose one by VID:PID:SERIAL: STLink V3";
        refused(probes(&["0034", "0035"]), None, choose, &["0483:374e:0034", other], "");
        // One of them, by its name: that it is attached to is seen by what its chip says.
        refused(probes(&["0034", "0035"]), Some(other), "", &[other, "the chip's identity"], "");
        for name in ["stlink", "0483", "0483:xyz", ""] {
            let says = format!("--probe={name}: must be VID:PID or VID:PID:SERIAL");
            refused(probes(&["0034"]), Some(name), &says, &[], "");
        }
    }

    #[test]
    fn a_probe_that_cannot_be_opened() {
        let forbidden = Probes { accessibility: Accessibility::PermissionDenied, ..probes(&["0034"]) };
        let rule = "this user may not open it: install probe-rs' udev rule (https://";
        refused(forbidden, None, "", &[rule], "");
        let busy = Probes { is_busy: true, ..probes(&["0034"]) };
        refused(busy, None, "", &["0483:374e:0034", "does another program"], "");
    }

    #[test]
    fn another_chip_is_left_alone() {
        let other_chip = "the chip's identity is 0x000, that of an STM32H743ZITx is 0x450";
        refused(probes(&["0034"]), None, "", &[other_chip], "nothing was written to it");
    }
}
