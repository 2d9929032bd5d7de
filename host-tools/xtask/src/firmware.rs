//! The programs of the board.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result};

use crate::process::{lock, run, target_dir};
use crate::toolchain::Toolchain;

/// As on the label.
pub const BOARD: &str = "NUCLEO-H743ZI2";
/// Its feature of the package, and its name in `slipsense sign --board`.
pub const FEATURE: &str = "h743";
pub const MEMORY_MAP: &str = "src/firmware/bin/app/board.x";
pub const NAME: &str = "slipsense-firmware";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Program {
    name: &'static str,
    features: &'static str,
}

impl Program {
    pub const FIRMWARE: Self = Self { name: NAME, features: FEATURE };
    /// The firmware for another accelerometer than the ADXL380.
    pub const ICM42688: Self = Self { name: NAME, features: "h743,icm42688" };
    /// And for a third one, with a crystal. Nothing runs it.
    pub const ADXL382: Self = Self { name: NAME, features: "h743,adxl382,crystal" };
    /// What `slipsense hil` talks to: the firmware with a mailbox in place of sensors and bus.
    pub const HIL: Self = Self { name: "slipsense-hil", features: FEATURE };
    pub const BRINGUP: Self = Self { name: "slipsense-bringup", features: FEATURE };
    pub const BOOTLOADER: Self = Self { name: "slipsense-boot", features: FEATURE };
    /// embassy's CAN driver sends to itself.
    pub const CAN_LOOPBACK: Self = Self { name: "slipsense-can-loopback", features: FEATURE };

    /// Build it, warnings denied, with a list of what each function takes of the stack.
    pub fn build(self) -> Result<PathBuf> {
        Self::build_all(&[self])?;
        Ok(self.kept())
    }

    /// The same for several. One core links a program, so neighbours with the same features are built together.
    pub fn build_all(programs: &[Self]) -> Result<()> {
        // A step may ask for one many times.
        static BUILT: Mutex<Vec<Program>> = Mutex::new(Vec::new());
        let mut built = BUILT.lock().unwrap_or_else(PoisonError::into_inner);
        let programs: Vec<_> = programs.iter().copied().filter(|program| !built.contains(program)).collect();
        if programs.is_empty() {
            return Ok(());
        }
        let _lock = lock("firmware")?;
        let toolchain = Toolchain::get()?;
        for same in programs.chunk_by(|a, b| a.features == b.features) {
            let mut build = toolchain.cargo("build");
            build.args(["--package", "slipsense", "--features", same[0].features]);
            run(build.args(same.iter().flat_map(|program| ["--bin", program.name])))?;
            same.iter().try_for_each(|program| program.keep(toolchain))?;
            built.extend(same);
        }
        Ok(())
    }

    /// The firmware for another accelerometer has the same name: the next build would take its place.
    fn keep(self, toolchain: Toolchain) -> Result<()> {
        let kept = self.kept();
        let unfinished = kept.with_extension("unfinished");
        std::fs::create_dir_all(kept.parent().expect("it has a folder"))
            .and_then(|()| std::fs::copy(toolchain.program(self.name), &unfinished))
            .and_then(|_| std::fs::rename(&unfinished, &kept))
            .with_context(|| kept.display().to_string())
    }

    fn kept(self) -> PathBuf {
        let name = format!("{}-{}", self.name, self.features.replace(',', "-"));
        target_dir().join("firmware-programs").join(name)
    }
}
