//! What stands between `slipsense hil --probe` and a probe, with probes that are a list and a chip that is probe-rs'
//! mock of a core: its memory is zeros.
#![cfg(feature = "hil")]

use std::fmt;

use probe_rs::integration::FakeProbe;
use probe_rs::probe::list::{Accessibility, Lister, ProbeListItem, ProbeLister};
use probe_rs::probe::{
    DebugProbe, DebugProbeError, DebugProbeInfo, DebugProbeSelector, Probe, ProbeCreationError, ProbeFactory,
};
use slipsense_cli::hil::probe::UsbProbe;

/// A NUCLEO's ST-LINK, and its serial numbers.
const VENDOR: u16 = 0x0483;
const PRODUCT: u16 = 0x374E;

/// What makes no probe: the list opens them.
#[derive(Debug)]
struct NoFactory;

impl fmt::Display for NoFactory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("fake")
    }
}

impl ProbeFactory for NoFactory {
    fn open(&self, _: &DebugProbeSelector) -> Result<Box<dyn DebugProbe>, DebugProbeError> {
        Err(ProbeCreationError::NotFound.into())
    }

    fn list_probes(&self) -> Vec<ProbeListItem> {
        Vec::new()
    }
}

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
            DebugProbeInfo::new("STLink V3", VENDOR, PRODUCT, serial, &NoFactory, None, false)
        };
        let infos = self.serials.iter().map(info);
        let wanted = infos.filter(|info| selector.is_none_or(|selector| selector.matches_probe(info)));
        wanted.map(|info| ProbeListItem { info, accessibility: self.accessibility }).collect()
    }
}

fn probes(serials: &[&'static str]) -> Probes {
    Probes { serials: serials.to_vec(), accessibility: Accessibility::Accessible, is_busy: false }
}

/// The error of attaching, as a user sees it.
fn refused(probes: Probes, name: Option<&str>) -> String {
    let attached = UsbProbe::attach(&Lister::with_lister(Box::new(probes)), board, name);
    let error = format!("{:#}", attached.err().expect("no chip of ours is there"));
    assert!(!error.contains('\n'), "one line: {error}");
    error
}

#[test]
fn no_probe() {
    let error = refused(probes(&[]), None);
    assert!(error.starts_with("--probe: no such debug probe is there: is the board's ST-LINK"), "{error}");
    let error = refused(probes(&["0034"]), Some("0483:374e:0035"));
    assert!(error.starts_with("--probe=0483:374e:0035: no such debug probe is there"), "{error}");
}

#[test]
fn several_probes() {
    let error = refused(probes(&["0034", "0035"]), None);
    assert!(error.starts_with("--probe: 2 debug probes, choose one by VID:PID:SERIAL: STLink V3"), "{error}");
    assert!(error.contains("0483:374e:0034") && error.contains("0483:374e:0035"), "{error}");
    // One of them, by its name: that it is attached to is seen by what its chip says.
    let error = refused(probes(&["0034", "0035"]), Some("0483:374e:0035"));
    assert!(error.contains("0483:374e:0035") && error.contains("the chip's identity"), "{error}");
}

#[test]
fn names_that_are_none() {
    for name in ["stlink", "0483", "0483:xyz", ""] {
        let error = refused(probes(&["0034"]), Some(name));
        let says = format!("--probe={name}: must be VID:PID or VID:PID:SERIAL");
        assert!(error.starts_with(&says), "{error}");
    }
}

#[test]
fn no_permission_and_no_room() {
    let mut forbidden = probes(&["0034"]);
    forbidden.accessibility = Accessibility::PermissionDenied;
    let error = refused(forbidden, None);
    assert!(error.contains("this user may not open it: install probe-rs' udev rule (https://"), "{error}");
    let mut busy = probes(&["0034"]);
    busy.is_busy = true;
    let error = refused(busy, None);
    assert!(error.contains("0483:374e:0034") && error.contains("does another program"), "{error}");
}

#[test]
fn another_chip_is_left_alone() {
    let error = refused(probes(&["0034"]), None);
    assert!(error.contains("the chip's identity is 0x000"), "{error}");
    let says = "that of an STM32H743ZITx is 0x450";
    assert!(error.contains(says) && error.ends_with("nothing was written to it"), "{error}");
}
