//! Recordings of a bus as files.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::candump::{CandumpReader, CandumpWriter, Rule};
use crate::mcap_file;
pub use crate::recording::{Format, Recording};
use crate::whole_file::write_whole;

pub fn read(path: &Path, format: Format) -> Result<Recording> {
    let read = match format {
        Format::Candump => read_candump(path),
        Format::Mcap => mcap_file::read(path),
    };
    let recording = read.with_context(|| path.display().to_string())?;
    if recording.entries.is_empty() && recording.displacement.is_empty() {
        bail!("{}: no CAN FD frame with a 29-bit identifier in it", path.display());
    }
    Ok(recording)
}

fn read_candump(path: &Path) -> Result<Recording> {
    let mut recording = Recording::default();
    let mut skipped = 0;
    for line in CandumpReader::new(BufReader::new(File::open(path).context("cannot read")?)) {
        match line {
            Ok(entry) => recording.entries.push(entry),
            Err(error) if matches!(error.rule, Rule::NotOurs) => skipped += 1,
            Err(error) => return Err(error.into()),
        }
    }
    if skipped > 0 {
        let note = format!("{skipped} frames that are not CAN FD with a 29-bit identifier are left out");
        recording.notes.push(note);
    }
    Ok(recording)
}

/// Write a recording; returns what the format cannot carry. An error leaves a file as it was.
pub fn write(path: &Path, format: Format, recording: &Recording) -> Result<Vec<String>> {
    let written = write_whole(path, |file| match format {
        Format::Candump => {
            let mut log = CandumpWriter::new(file, "can0")?;
            recording.entries.iter().try_for_each(|entry| log.write_entry(entry))?;
            log.finish()?;
            Ok(())
        }
        Format::Mcap => mcap_file::write(file, recording),
    });
    written.with_context(|| format!("{}: cannot write", path.display()))?;
    let lost = format != Format::Mcap && !recording.displacement.is_empty();
    Ok(lost.then(|| "the crosshead's displacement is left out".to_owned()).into_iter().collect())
}
