//! Updates over the bus in the board twin, and a supply that fails in between.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2};

use super::{MODEL, OTHER_XL, firmware_with, with_far_end};
use crate::board::Board;
use crate::process::{cargo, run as start};
use crate::python::python;

const CHECK: &str = "tests/python/check_twin_update.py";
/// What the emulated board starts with is 0.1.0, the package's version.
const NEW: &str = "0.2.0";
const OLDER: &str = "0.0.1";
const HANGING: &str = "0.1.1";
/// The hanging one is tried once, and ended by the watchdog.
const BITES: &str = "1";
/// End of DTCM.
const STACK: u32 = 0x2002_0000;
/// `b .`
const BRANCH_TO_ITSELF: u16 = 0xE7FE;

/// In the test command: pycyphal updates firmware and model of the board over the modelled bus, with the bootloader in
/// place; the supply fails in between, at a few steps of the flash. `thorough`: at many.
pub fn step(thorough: bool) -> Result<()> {
    let firmware = Board::H743.build()?;
    // The firmware for another accelerometer differs from the first byte on, and was built for another step.
    let new = firmware_with(OTHER_XL)?;
    let boot = Board::build_bootloader()?;
    let folder = tempfile::tempdir().context("cannot make a folder for the images")?;
    let folder = folder.path();
    sign(&new, Some(Board::H743), NEW, None, &folder.join("new.slip"))?;
    sign(&firmware, Some(Board::H743), OLDER, None, &folder.join("older.slip"))?;
    let hanging = folder.join("hanging.bin");
    std::fs::write(&hanging, hanging_firmware()).with_context(|| hanging.display().to_string())?;
    sign(&hanging, Some(Board::H743), HANGING, None, &folder.join("hanging.slip"))?;
    let key = folder.join("foreign.key");
    start(slipsense("keygen").arg("--out").arg(&key))?;
    sign(&new, Some(Board::H743), NEW, Some(&key), &folder.join("foreign.slip"))?;
    sign(Path::new(MODEL), None, "1.0.0", None, &folder.join("model.slip"))?;
    let boot = boot.display().to_string();
    with_far_end(&firmware, &["--boot", &boot, "--bites", BITES], |port| {
        let mut check = python()?;
        check.arg(CHECK).arg(port).arg("--folder").arg(folder).args(["--model", MODEL]);
        start(check.args(thorough.then_some("--thorough")))
    })
}

fn slipsense(command: &str) -> std::process::Command {
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--", command]);
    slipsense
}

fn sign(file: &Path, board: Option<Board>, version: &str, key: Option<&Path>, out: &Path) -> Result<()> {
    let mut sign = slipsense("sign");
    sign.arg(file).args(["--version", version, "--out"]).arg(out);
    sign.args(board.map(|board| ["--board", board.feature()]).into_iter().flatten());
    match key {
        Some(key) => sign.arg("--key").arg(key),
        None => sign.arg("--development-key"),
    };
    start(&mut sign)
}

/// A firmware that is whole and does nothing, for ever: only a watchdog ends it.
fn hanging_firmware() -> Vec<u8> {
    let entry = FLASH_BASE + NUCLEO_H743ZI2.active.start + 2 * size_of::<u32>() as u32;
    let thumb = entry | 1;
    [&STACK.to_le_bytes()[..], &thumb.to_le_bytes(), &BRANCH_TO_ITSELF.to_le_bytes()].concat()
}
