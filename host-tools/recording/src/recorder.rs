//! A recording in the making, which a kill leaves readable.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::candump::{CandumpWriter, LogEntry};
use anyhow::{Context, Result};

use crate::mcap_file::McapSink;
use crate::recording::Format;

/// Writes frames to a file as they come. Everything before the last [`flush`](Self::flush) is on the disk whatever
/// happens.
pub enum Recorder {
    /// A candump log, and its lines since the last flush: a log that is cut has whole lines.
    Candump(File, CandumpWriter<Vec<u8>>),
    /// MCAP, and the file once more, to have it written to the disk.
    Mcap(Box<McapSink<BufWriter<File>>>, File),
}

impl Recorder {
    /// A new file; one that is there already is refused.
    pub fn create(path: &Path) -> Result<Self> {
        let format = Format::from_path(path)
            .with_context(|| format!("{}: must end in .mcap or .log", path.display()))?;
        let file =
            File::create_new(path).with_context(|| format!("{}: cannot make a new file", path.display()))?;
        Ok(match format {
            Format::Mcap => {
                let disk = file.try_clone()?;
                Self::Mcap(Box::new(McapSink::new(BufWriter::new(file))?), disk)
            }
            Format::Candump => Self::Candump(file, CandumpWriter::new(Vec::new(), "can0")?),
        })
    }

    pub fn write(&mut self, entry: &LogEntry) -> Result<()> {
        match self {
            Self::Candump(_, lines) => Ok(lines.write_entry(entry)?),
            Self::Mcap(sink, _) => sink.write(entry),
        }
    }

    /// Write everything to the disk; to be called every second or so.
    pub fn flush(&mut self) -> Result<()> {
        match self {
            Self::Candump(file, lines) => {
                file.write_all(&std::mem::take(lines.flushed()?))?;
                Ok(file.sync_data()?)
            }
            Self::Mcap(sink, disk) => {
                sink.flush()?;
                Ok(disk.sync_data()?)
            }
        }
    }

    /// Write everything out and end the file as its format asks.
    pub fn finish(mut self) -> Result<()> {
        match self {
            Self::Candump(..) => self.flush(),
            Self::Mcap(sink, disk) => {
                sink.finish()?.flush()?;
                Ok(disk.sync_data()?)
            }
        }
    }
}
