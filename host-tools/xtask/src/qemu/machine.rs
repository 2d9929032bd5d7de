//! QEMU's Cortex-M7 board: build a program of `tests/qemu` for it, run it in a folder.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use slipsense::board::replay::encode_frame;
use slipsense_qemu::INPUT_FILE;
use tempfile::TempDir;

use super::frames::Frames;
use crate::process::{Running, command, find, need, run};
use crate::toolchain::Toolchain;

const EMULATOR: &str = "qemu-system-arm";
pub const PACKAGE: &str = "slipsense-qemu";
/// One instruction takes 2^7 ns of the emulated clock: with this, runs repeat exactly and times count
/// instructions.
const ICOUNT: &str = "shift=7";

/// A run that takes longer hangs.
const LIMIT: Duration = Duration::from_secs(900);

pub struct Machine {
    emulator: PathBuf,
    pub program: PathBuf,
}

impl Machine {
    /// Build the program; install QEMU where it is missing and may be installed.
    pub fn build(program: &str) -> Result<Self> {
        Self::build_with(program, &[])
    }

    pub fn build_with(program: &str, arguments: &[String]) -> Result<Self> {
        need(EMULATOR, &[EMULATOR], "emulating the microcontroller")?;
        let emulator = find(EMULATOR).with_context(|| format!("`{EMULATOR}` is not on the PATH"))?;
        let toolchain = Toolchain::get()?;
        run(toolchain.cargo("build").args(["--package", PACKAGE, "--bin", program]).args(arguments))?;
        Ok(Self { emulator, program: toolchain.program(program) })
    }

    /// Run to the end, with `dir` as the folder of the program's files; what it prints.
    pub fn run(&self, dir: &Path) -> Result<String> {
        let path = dir.join("log");
        let log = File::create(&path)?;
        let child = self.command(dir, "none").stdout(log.try_clone()?).stderr(log).spawn();
        let mut child = Running(child.with_context(|| format!("cannot start {}", self.emulator.display()))?);
        let status = child.wait(LIMIT)?;
        let log = fs::read_to_string(&path).unwrap_or_default();
        let Some(status) = status else {
            bail!("the emulated program did not end within {} s\n{log}", LIMIT.as_secs());
        };
        ensure!(status.success(), "the emulated program failed, {status}\n{log}");
        Ok(log)
    }

    /// What a program prints that reads and writes no files.
    pub fn print(&self) -> Result<String> {
        let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
        self.run(dir.path())
    }

    /// The emulator, with a monitor on `monitor`.
    pub fn command(&self, dir: &Path, monitor: &str) -> Command {
        let mut command = command(&self.emulator);
        command
            .current_dir(dir)
            .args(["-cpu", "cortex-m7", "-machine", "mps2-an500", "-display", "none"])
            .args(["-monitor", monitor, "-serial", "none", "-icount", ICOUNT])
            .args(["-semihosting-config", "enable=on,target=native"])
            .arg("-kernel")
            .arg(&self.program)
            .stdin(Stdio::null())
            .stdout(Stdio::null());
        command
    }
}

/// A folder to run in, with model and frames in the form that the emulated programs read.
pub fn folder(frames: &Frames, model: &[u8]) -> Result<TempDir> {
    let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
    write_input(&dir.path().join(INPUT_FILE), frames, model).context("cannot write the input file")?;
    Ok(dir)
}

fn write_input(path: &Path, frames: &Frames, model: &[u8]) -> Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    file.write_all(&frames.header(model)?.encode())?;
    file.write_all(model)?;
    for (stamp, parts) in &frames.list {
        let mut record = Vec::new();
        encode_frame(*stamp, parts, |bytes| record.extend_from_slice(bytes));
        file.write_all(&record)?;
    }
    Ok(file.into_inner().map_err(|error| error.into_error())?.sync_data()?)
}
