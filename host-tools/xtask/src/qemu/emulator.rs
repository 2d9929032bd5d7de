//! The signal path on the emulated board: frames in, records out.

use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use slipsense_qemu::record::Record;
use slipsense_qemu::{INPUT_FILE, OUTPUT_FILE};

use crate::cmsis;

use super::frames::Frames;
use super::machine::{Machine, NS_PER_INSTRUCTION_LOG2, write_input};

const PROGRAM: &str = "slipsense-qemu";

/// The built program and its machine.
pub struct Emulator(Machine);

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
    /// Build the program with the FFT that this computer's library has; install QEMU where it is missing and may be
    /// installed.
    pub fn build() -> Result<Self> {
        Machine::build(PROGRAM, cmsis::FEATURES_HERE).map(Self)
    }

    /// Run all frames.
    pub fn run(&self, frames: &Frames, model: &[u8], timeout: Duration) -> Result<Output> {
        let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
        write_input(&dir.path().join(INPUT_FILE), frames, model).context("cannot write the input file")?;
        let start = Instant::now();
        self.0.run(dir.path(), timeout)?;
        let records = read_output(&dir.path().join(OUTPUT_FILE))?;
        if records.len() != frames.len() {
            bail!("the emulated program wrote {} records of {} frames", records.len(), frames.len());
        }
        Ok(Output { records, wall_time: start.elapsed() })
    }
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
