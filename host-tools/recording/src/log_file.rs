//! Recordings of a bus as files, by the ending of their names.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use crate::candump::{CandumpReader, CandumpWriter, LogEntry, Rule};
use anyhow::{Context, Result, bail};

use crate::{asc, mcap_file, vector};

/// A format that carries CAN frames with their times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// can-utils' text, `.log` or `.candump`.
    Candump,
    /// MCAP, `.mcap`.
    Mcap,
    /// Vector's text, `.asc`.
    Asc,
    /// Vector's binary, `.blf`.
    Blf,
}

impl Format {
    /// By the ending of a file's name.
    pub fn of(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "log" | "candump" => Some(Self::Candump),
            "mcap" => Some(Self::Mcap),
            "asc" => Some(Self::Asc),
            "blf" => Some(Self::Blf),
            _ => None,
        }
    }
}

/// What a recording holds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Frames, in the order of the file.
    pub entries: Vec<LogEntry>,
    /// Position of a test stand's crosshead: microseconds, mm.
    pub displacement: Vec<(u64, f64)>,
    /// What the file has and this cannot hold, or what is wrong with it, in words.
    pub notes: Vec<String>,
}

impl Recording {
    /// Note what was passed over, if anything was.
    pub(crate) fn note_skipped(&mut self, frames: u64) {
        if frames > 0 {
            self.notes
                .push(format!("{frames} frames that are not CAN FD with a 29-bit identifier are left out"));
        }
    }
}

/// Read a recording.
pub fn read(path: &Path, format: Format) -> Result<Recording> {
    let read = match format {
        Format::Candump => candump(path),
        Format::Mcap => mcap_file::read(path),
        Format::Asc => asc::read(path),
        Format::Blf => vector::read_blf(path),
    };
    let recording = read.with_context(|| path.display().to_string())?;
    if recording.entries.is_empty() && recording.displacement.is_empty() {
        bail!("{}: no CAN FD frame with a 29-bit identifier in it", path.display());
    }
    Ok(recording)
}

fn candump(path: &Path) -> Result<Recording> {
    let mut recording = Recording::default();
    let mut skipped = 0;
    for line in CandumpReader::new(BufReader::new(File::open(path).context("cannot read")?)) {
        match line {
            Ok(entry) => recording.entries.push(entry),
            Err(error) if matches!(error.rule, Rule::NotOurs) => skipped += 1,
            Err(error) => return Err(error.into()),
        }
    }
    recording.note_skipped(skipped);
    Ok(recording)
}

/// Write a recording; what the format cannot carry is said. An error leaves a file as it was.
pub fn write(path: &Path, format: Format, recording: &Recording) -> Result<Vec<String>> {
    let written = whole(path, |partial| match format {
        Format::Candump => write_candump(partial, &recording.entries),
        Format::Mcap => mcap_file::write(partial, recording).map(|()| Vec::new()),
        Format::Asc => asc::write(partial, &recording.entries),
        Format::Blf => vector::write_blf(partial, &recording.entries),
    });
    let mut notes = written.with_context(|| format!("{}: cannot write", path.display()))?;
    if format != Format::Mcap && !recording.displacement.is_empty() {
        notes.push("the crosshead's displacement is left out".to_owned());
    }
    Ok(notes)
}

fn write_candump(path: &Path, entries: &[LogEntry]) -> Result<Vec<String>> {
    // A writer has one interface, a log may have several.
    let mut out = File::create(path)?;
    let mut rest = entries;
    while let Some(first) = rest.first() {
        let run = rest.iter().take_while(|entry| entry.interface == first.interface).count();
        let (same, after) = rest.split_at(run);
        let mut writer = CandumpWriter::new(out, &first.interface)?;
        for entry in same {
            writer.write(entry.timestamp_us, &entry.frame)?;
        }
        out = writer.finish()?;
        rest = after;
    }
    Ok(Vec::new())
}

/// Let `fill` write a file beside `path`, then move it there.
fn whole<T>(path: &Path, fill: impl FnOnce(&Path) -> Result<T>) -> Result<T> {
    let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
    let dir = tempfile::Builder::new().prefix(".slipsense-").suffix(".partial").tempdir_in(folder)?;
    let partial = dir.path().join("file");
    let result = fill(&partial)?;
    std::fs::rename(partial, path)?;
    Ok(result)
}
