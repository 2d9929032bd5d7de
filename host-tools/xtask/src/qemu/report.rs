//! All runs in a table, or as JSON.

use std::fmt;
use std::time::Duration;

use serde::Serialize;

use super::compare::{Comparison, Counts};
use super::emulator::Output;

/// One run.
#[derive(Clone, Debug, Serialize)]
struct Row {
    input: String,
    sensors: usize,
    frames: usize,
    can_frames: usize,
    slip_frames: usize,
    /// Frames that differ, by part.
    mismatches: Counts,
    first_mismatches: Vec<String>,
    /// Emulated instructions of the pipeline per frame; acquisition that interrupts it is included.
    instructions_median: u64,
    instructions_max: u64,
    emulator_s: f64,
    host_s: f64,
}

/// All runs.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    model: String,
    mismatching_frames: usize,
    frames: usize,
    runs: Vec<Row>,
}

impl Report {
    pub fn new(model: String) -> Self {
        Self { model, mismatching_frames: 0, frames: 0, runs: Vec::new() }
    }

    pub fn add(
        &mut self,
        input: String,
        sensors: usize,
        output: &Output,
        host_time: Duration,
        comparison: Comparison,
    ) {
        let Comparison { counts, can_frames, slip_frames, first } = comparison;
        let (instructions_median, instructions_max) = output.instructions();
        self.mismatching_frames += counts.frames;
        self.frames += output.records.len();
        self.runs.push(Row {
            input,
            sensors,
            frames: output.records.len(),
            can_frames,
            slip_frames,
            mismatches: counts,
            first_mismatches: first,
            instructions_median,
            instructions_max,
            emulator_s: output.wall_time.as_secs_f64(),
            host_s: host_time.as_secs_f64(),
        });
    }

    pub fn all_equal(&self) -> bool {
        self.mismatching_frames == 0
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "\nFrames that differ between this computer and the emulated Cortex-M7; model {}",
            self.model
        )?;
        writeln!(
            f,
            "{:>7} {:>7} {:>8} {:>7} {:>6} {:>5} {:>5} {:>6} {:>6} {:>4} {:>9} {:>9}  input",
            "frames",
            "sensors",
            "features",
            "logits",
            "class",
            "slip",
            "alarm",
            "health",
            "CAN",
            "any",
            "instr.",
            "max"
        )?;
        for row in &self.runs {
            let m = &row.mismatches;
            writeln!(
                f,
                "{:>7} {:>7} {:>8} {:>7} {:>6} {:>5} {:>5} {:>6} {:>6} {:>4} {:>9} {:>9}  {}",
                row.frames,
                row.sensors,
                m.features,
                m.logits,
                m.class,
                m.slip,
                m.alarm,
                m.health,
                m.can,
                m.frames,
                row.instructions_median,
                row.instructions_max,
                row.input
            )?;
        }
        writeln!(
            f,
            "instr., max: emulated instructions of the pipeline per frame, median and largest; not cycles"
        )?;
        writeln!(f, "{} mismatching frames of {}", self.mismatching_frames, self.frames)
    }
}
