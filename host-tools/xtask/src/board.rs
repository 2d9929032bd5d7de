//! The boards that there is firmware for.

use std::path::PathBuf;

use anyhow::Result;
use clap::ValueEnum;
use serde::Serialize;

use crate::process::run;
use crate::toolchain::Toolchain;

const FIRMWARE: &str = "slipsense-firmware";
/// What `slipsense hil` talks to.
const HIL: &str = "slipsense-hil";
const BOOTLOADER: &str = "slipsense-boot";
const BOOT_PROFILE: &str = "boot";

/// A board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize)]
pub enum Board {
    /// NUCLEO-H743ZI2
    H743,
}

impl Board {
    pub const ALL: [Self; 1] = [Self::H743];

    /// Its feature of the package, and its folder in `src/board`.
    pub const fn feature(self) -> &'static str {
        match self {
            Self::H743 => "h743",
        }
    }

    /// As on the label.
    pub const fn label(self) -> &'static str {
        match self {
            Self::H743 => "NUCLEO-H743ZI2",
        }
    }

    /// Build the bootloader, in a profile of its own, as it is flashed.
    pub fn build_bootloader() -> Result<PathBuf> {
        let toolchain = Toolchain::get()?;
        let mut build = toolchain.build_in(BOOT_PROFILE);
        let feature = Self::H743.feature();
        run(build.args(["--package", "slipsense", "--bin", BOOTLOADER, "--features", feature]))?;
        Ok(toolchain.program_in(BOOT_PROFILE, BOOTLOADER))
    }

    /// Build its firmware, warnings denied, with a list of what each function takes of the stack.
    pub fn build(self) -> Result<PathBuf> {
        self.build_program(FIRMWARE)
    }

    /// The same of the program with a mailbox in place of sensors and bus.
    pub fn build_hil(self) -> Result<PathBuf> {
        self.build_program(HIL)
    }

    fn build_program(self, name: &str) -> Result<PathBuf> {
        let toolchain = Toolchain::get()?;
        let mut build = toolchain.build_with_stack_sizes();
        run(build.args(["--package", "slipsense", "--bin", name, "--features", self.feature()]))?;
        // Every board's program has this name: the next build would take its place.
        let built = toolchain.program(name);
        let kept = built.with_file_name(format!("{name}-{}", self.feature()));
        std::fs::copy(built, &kept)?;
        Ok(kept)
    }
}
