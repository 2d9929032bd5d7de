//! QEMU: build the program, write its input file, run it, read its output file.

use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::process::{ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use slipsense_qemu::input::{Header, encode_frame};
use slipsense_qemu::record::Record;
use slipsense_qemu::{INPUT_FILE, OUTPUT_FILE};

use super::frames::Frames;
use super::host::NODE;
use crate::process::{apt_install, command, find, run};
use crate::toolchain::Toolchain;

const PROGRAM: &str = "qemu-system-arm";
const PACKAGE: &str = "slipsense-qemu";
/// One instruction takes 2^7 ns of the emulated clock: with this, runs repeat exactly and times count
/// instructions.
const NS_PER_INSTRUCTION_LOG2: u32 = 7;

/// A built program and an emulator to run it.
pub struct Emulator {
    qemu: PathBuf,
    program: PathBuf,
}

/// What a run gave.
pub struct Output {
    pub records: Vec<Record>,
    pub wall_time: Duration,
}

impl Output {
    /// Instructions that the pipeline took per frame: median and largest.
    pub fn instructions(&self) -> (u64, u64) {
        let mut counts: Vec<u64> = self
            .records
            .iter()
            .map(|record| (u64::from(record.step_us) * 1000) >> NS_PER_INSTRUCTION_LOG2)
            .collect();
        counts.sort_unstable();
        let median = counts.get(counts.len() / 2).copied().unwrap_or_default();
        (median, counts.last().copied().unwrap_or_default())
    }
}

impl Emulator {
    /// Build the program; install QEMU where it is missing and may be installed.
    pub fn build() -> Result<Self> {
        if find(PROGRAM).is_none() {
            apt_install(&[PROGRAM], "emulating the microcontroller")?;
        }
        let qemu = find(PROGRAM).with_context(|| format!("`{PROGRAM}` is not on the PATH"))?;
        let toolchain = Toolchain::get()?;
        run(toolchain.build().args(["--package", PACKAGE, "--bin", PACKAGE]))?;
        Ok(Self { qemu, program: toolchain.program(PACKAGE) })
    }

    /// Run all frames.
    pub fn run(&self, frames: &Frames, model: &[u8], timeout: Duration) -> Result<Output> {
        let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
        write_input(&dir.path().join(INPUT_FILE), frames, model).context("cannot write the input file")?;
        let start = Instant::now();
        let status = self.start_and_wait(dir.path(), timeout)?;
        let log = fs::read_to_string(dir.path().join("log")).unwrap_or_default();
        let Some(status) = status else {
            bail!("the emulated program did not end within {} s\n{log}", timeout.as_secs());
        };
        if !status.success() {
            bail!("the emulated program failed, {status}\n{log}");
        }
        let records = read_output(&dir.path().join(OUTPUT_FILE))?;
        if records.len() != frames.len() {
            bail!("the emulated program wrote {} records of {} frames", records.len(), frames.len());
        }
        Ok(Output { records, wall_time: start.elapsed() })
    }

    /// `None`: it did not end in time, and has been stopped.
    fn start_and_wait(&self, dir: &Path, timeout: Duration) -> Result<Option<ExitStatus>> {
        let log = File::create(dir.join("log"))?;
        let mut child = command(&self.qemu)
            .current_dir(dir)
            .args(["-cpu", "cortex-m7", "-machine", "mps2-an500", "-display", "none"])
            .args(["-monitor", "none", "-serial", "none"])
            .args(["-semihosting-config", "enable=on,target=native"])
            .args(["-icount", &format!("shift={NS_PER_INSTRUCTION_LOG2}")])
            .arg("-kernel")
            .arg(&self.program)
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            .spawn()
            .with_context(|| format!("cannot start {}", self.qemu.display()))?;
        let deadline = Instant::now() + timeout;
        loop {
            if let Some(status) = child.try_wait()? {
                return Ok(Some(status));
            }
            if Instant::now() > deadline {
                child.kill()?;
                child.wait()?;
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

fn write_input(path: &Path, frames: &Frames, model: &[u8]) -> Result<()> {
    let mut file = BufWriter::new(File::create(path)?);
    let header = Header {
        model_bytes: u32::try_from(model.len())?,
        sensors: u32::try_from(frames.sensors())?,
        frames: u32::try_from(frames.len())?,
        node: NODE,
    };
    file.write_all(&header.encode())?;
    file.write_all(model)?;
    let mut record = Vec::new();
    for (stamp, parts) in frames.iter() {
        record.clear();
        encode_frame(stamp, parts, |bytes| record.extend_from_slice(bytes));
        file.write_all(&record)?;
    }
    Ok(file.into_inner().map_err(|error| error.into_error())?.sync_data()?)
}

fn read_output(path: &Path) -> Result<Vec<Record>> {
    let bytes = fs::read(path).context("the emulated program wrote no output")?;
    let mut rest = &bytes[..];
    let mut records = Vec::new();
    while !rest.is_empty() {
        let at = bytes.len() - rest.len();
        records.push(
            Record::decode(&mut rest).with_context(|| format!("no record at byte {at} of the output"))?,
        );
    }
    Ok(records)
}
