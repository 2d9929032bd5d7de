//! Updates over the bus in the board twin, and a supply that fails in between.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2};

use super::machine::{MODEL, twin_with, with_far_end};
use crate::firmware::{FEATURE, Program};
use crate::process::{command, run as start, script};

/// What the emulated board starts with is 0.1.0, the package's version.
const NEW: &str = "0.2.0";
const OLDER: &str = "0.0.1";
const HANGING: &str = "0.1.1";
/// How often the watchdog bites: the hanging firmware is tried once.
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
    let folder = tempfile::tempdir().context("cannot make a folder for the images")?;
    let folder = folder.path();
    let hanging = folder.join("hanging.bin");
    std::fs::write(&hanging, hanging_firmware()).with_context(|| hanging.display().to_string())?;
    let key = folder.join("foreign.key");
    start(command(slipsense).args(["keygen", "--out"]).arg(&key))?;
    for (name, version) in
        [("model.slip", "1.0.0"), ("older-model.slip", "0.9.0"), ("newer-model.slip", "1.1.0")]
    {
        sign_model(slipsense, &folder.join(name), version)?;
    }
    for (name, file, version, key) in [
        ("new.slip", &new, NEW, None),
        ("older.slip", &firmware, OLDER, None),
        ("hanging.slip", &hanging, HANGING, None),
        ("foreign.slip", &new, NEW, Some(&key)),
    ] {
        sign_firmware(slipsense, file, &folder.join(name), version, key)?;
    }
    let mut twin = twin_with(&firmware)?;
    twin.arg("--boot").arg(boot).args(["--bites", BITES]);
    with_far_end(twin, |port| {
        let mut check = script("check_twin_update.py")?;
        start(check.arg(port).arg(folder).arg(MODEL).args(thorough.then_some("--thorough")))
    })
}

/// By the development key, if no other is given.
fn sign_firmware(
    slipsense: &Path,
    file: &Path,
    out: &Path,
    version: &str,
    key: Option<&PathBuf>,
) -> Result<()> {
    let mut sign = command(slipsense);
    sign.arg("sign").arg(file).args(["--version", version, "--board", FEATURE, "--out"]).arg(out);
    match key {
        Some(key) => sign.arg("--key").arg(key),
        None => sign.arg("--development-key"),
    };
    start(&mut sign)
}

fn sign_model(slipsense: &Path, out: &Path, version: &str) -> Result<()> {
    let mut sign = command(slipsense);
    sign.args(["sign", MODEL, "--version", version, "--development-key", "--out"]);
    start(sign.arg(out))
}

/// The bootloader on firmwares that it must refuse, of a foreign key and with a damaged payload, while so many of its
/// instructions are skipped, one in each run.
pub fn boot_skips(slipsense: &Path, count: u32) -> Result<()> {
    let folder = tempfile::tempdir().context("cannot make a folder for the images")?;
    let [program, key, foreign, damaged] =
        ["hanging.bin", "foreign.key", "foreign.slip", "damaged.slip"].map(|name| folder.path().join(name));
    std::fs::write(&program, hanging_firmware()).with_context(|| program.display().to_string())?;
    start(command(slipsense).args(["keygen", "--out"]).arg(&key))?;
    sign_firmware(slipsense, &program, &foreign, HANGING, Some(&key))?;
    sign_firmware(slipsense, &program, &damaged, HANGING, None)?;
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
        start(twin.args(["--seconds", "1", "--hse-hz", hse_hz, "--says", says]))?;
    }
    let folder = tempfile::tempdir().context("cannot make a folder for the images")?;
    sign_model(slipsense, &folder.path().join("model.slip"), "1.0.0")?;
    let mut twin = twin_with(&firmware)?;
    // The watchdog ends the hang.
    twin.arg("--boot").arg(boot).args(["--bites", "1"]);
    with_far_end(twin, |port| {
        start(script("check_twin_faults.py")?.arg(port).arg(folder.path()).arg(operations))
    })
}

/// A firmware that is whole and does nothing, for ever: only a watchdog ends it.
fn hanging_firmware() -> Vec<u8> {
    let entry = FLASH_BASE + NUCLEO_H743ZI2.active.start + 2 * size_of::<u32>() as u32;
    let thumb = entry | 1;
    [&STACK.to_le_bytes()[..], &thumb.to_le_bytes(), &BRANCH_TO_ITSELF.to_le_bytes()].concat()
}
