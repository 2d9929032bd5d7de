//! Updates over the bus in the board twin, and a supply that fails in between.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2};
use tempfile::TempDir;

use super::machine::{MODEL, twin_with, with_far_end};
use crate::firmware::{FEATURE, Program};
use crate::process::{command, run as start, script};

/// What the emulated board starts with is 0.1.0, the package's version.
const NEW: &str = "0.2.0";
const OLDER: &str = "0.0.1";
const HANGING: &str = "0.1.1";
/// How often the watchdog bites: what hangs is tried once.
const BITES: &str = "1";
/// End of DTCM.
const STACK: u32 = 0x2002_0000;
/// `b .`
const BRANCH_TO_ITSELF: u16 = 0xE7FE;

/// pycyphal updates firmware and model of the board over the modelled bus, with the bootloader in place; the supply
/// fails in between, at a few steps of the flash. `thorough`: at many.
pub fn step(slipsense: &Path, thorough: bool) -> Result<()> {
    let firmware = Program::FIRMWARE.build()?;
    // The firmware for another accelerometer differs from the first byte on, and was built for another step.
    let new = Program::ICM42688.build()?;
    let boot = Program::BOOTLOADER.build()?;
    let images = Images::new(slipsense)?;
    let (hanging, key, model) = (images.hanging()?, images.foreign_key()?, Path::new(MODEL));
    images.sign("model.slip", model, "1.0.0", None)?;
    images.sign("older-model.slip", model, "0.9.0", None)?;
    images.sign("newer-model.slip", model, "1.1.0", None)?;
    images.sign("new.slip", &new, NEW, None)?;
    images.sign("older.slip", &firmware, OLDER, None)?;
    images.sign("hanging.slip", &hanging, HANGING, None)?;
    images.sign("foreign.slip", &new, NEW, Some(&key))?;
    let mut twin = twin_with(&firmware)?;
    twin.arg("--boot").arg(boot).args(["--bites", BITES]);
    with_far_end(twin, |port| {
        let mut check = script("check_twin_update.py")?;
        start(check.arg(port).arg(images.folder.path()).arg(MODEL).args(thorough.then_some("--thorough")))
    })
}

/// What the board is sent, in a folder of its own.
struct Images<'s> {
    slipsense: &'s Path,
    folder: TempDir,
}

impl<'s> Images<'s> {
    fn new(slipsense: &'s Path) -> Result<Self> {
        let folder = tempfile::tempdir().context("cannot make a folder for the images")?;
        Ok(Self { slipsense, folder })
    }

    /// A firmware that is whole and does nothing, for ever: only a watchdog ends it.
    fn hanging(&self) -> Result<PathBuf> {
        let entry = FLASH_BASE + NUCLEO_H743ZI2.active.start + 2 * size_of::<u32>() as u32;
        let thumb = entry | 1;
        let firmware =
            [&STACK.to_le_bytes()[..], &thumb.to_le_bytes(), &BRANCH_TO_ITSELF.to_le_bytes()].concat();
        let path = self.folder.path().join("hanging.bin");
        std::fs::write(&path, firmware).with_context(|| path.display().to_string())?;
        Ok(path)
    }

    /// A key that the board does not know.
    fn foreign_key(&self) -> Result<PathBuf> {
        let key = self.folder.path().join("foreign.key");
        start(command(self.slipsense).args(["keygen", "--out"]).arg(&key))?;
        Ok(key)
    }

    /// Model or firmware, signed by the development key, if no other is given.
    fn sign(&self, name: &str, file: &Path, version: &str, key: Option<&Path>) -> Result<PathBuf> {
        let out = self.folder.path().join(name);
        let mut sign = command(self.slipsense);
        sign.arg("sign").arg(file).args(["--version", version, "--out"]).arg(&out);
        if file != Path::new(MODEL) {
            sign.args(["--board", FEATURE]);
        }
        match key {
            Some(key) => sign.arg("--key").arg(key),
            None => sign.arg("--development-key"),
        };
        start(&mut sign)?;
        Ok(out)
    }
}

/// The bootloader on firmwares that it must refuse, of a foreign key and with a damaged payload, while so many of its
/// instructions are skipped, one in each run.
pub fn boot_skips(slipsense: &Path, count: u32) -> Result<()> {
    let images = Images::new(slipsense)?;
    let (hanging, key) = (images.hanging()?, images.foreign_key()?);
    let foreign = images.sign("foreign.slip", &hanging, HANGING, Some(&key))?;
    let damaged = images.sign("damaged.slip", &hanging, HANGING, None)?;
    let mut image = std::fs::read(&damaged)?;
    *image.last_mut().context("an image has a payload")? ^= 1;
    std::fs::write(&damaged, image)?;
    let mut twin = twin_with(&Program::FIRMWARE.build()?)?;
    twin.arg("--boot").arg(Program::BOOTLOADER.build()?).args(["--boot-skips", &count.to_string()]);
    start(twin.arg("--slot").arg(foreign).arg("--slot").arg(damaged))
}

/// What goes wrong on the board itself: pycyphal asks what is left of it, and stores and updates while the flash raises
/// flags of reads, so often. And the board without its clock, and with a wrong one.
pub fn faults(slipsense: &Path, operations: &str) -> Result<()> {
    let firmware = Program::FIRMWARE.build()?;
    let boot = Program::BOOTLOADER.build()?;
    for (hse_hz, says) in [("0", "external clock: 0 Hz found"), ("25000000", "external clock: 25")] {
        let mut twin = twin_with(&firmware)?;
        start(twin.args(["--seconds", "0.5", "--hse-hz", hse_hz, "--says", says]))?;
    }
    let images = Images::new(slipsense)?;
    images.sign("model.slip", Path::new(MODEL), "1.0.0", None)?;
    let mut twin = twin_with(&firmware)?;
    twin.arg("--boot").arg(boot).args(["--bites", BITES]);
    with_far_end(twin, |port| {
        start(script("check_twin_faults.py")?.arg(port).arg(images.folder.path()).arg(operations))
    })
}
