//! A recording in the making, which a kill leaves readable.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::candump::{CandumpWriter, LogEntry};
use anyhow::{Context, Result, bail};

use crate::log_file::Format;
use crate::mcap_file::McapSink;

/// Writes frames to a file as they come. Everything before the last [`flush`](Self::flush) is there whatever happens.
pub enum Recorder {
    /// A candump log.
    Candump(Box<CandumpLog>),
    /// MCAP.
    Mcap(Box<McapSink<BufWriter<File>>>),
}

/// A candump log of one or several interfaces.
pub struct CandumpLog {
    file: File,
    /// Lines since the last flush.
    pending: Vec<LogEntry>,
}

impl Recorder {
    /// A new file; one that is there already is refused.
    pub fn create(path: &Path) -> Result<Self> {
        let format = Format::of(path);
        if !matches!(format, Some(Format::Candump | Format::Mcap)) {
            bail!("{}: must end in .mcap or .log; `slipsense convert` makes the others", path.display());
        }
        let file =
            File::create_new(path).with_context(|| format!("{}: cannot make a new file", path.display()))?;
        Ok(match format {
            Some(Format::Mcap) => Self::Mcap(Box::new(McapSink::new(BufWriter::new(file))?)),
            _ => Self::Candump(Box::new(CandumpLog { file, pending: Vec::new() })),
        })
    }

    /// Append a frame.
    pub fn write(&mut self, entry: &LogEntry) -> Result<()> {
        match self {
            Self::Candump(log) => log.pending.push(entry.clone()),
            Self::Mcap(sink) => sink.write(entry)?,
        }
        Ok(())
    }

    /// Write everything out; to be called every second or so.
    pub fn flush(&mut self) -> Result<()> {
        match self {
            Self::Candump(log) => log.flush(),
            Self::Mcap(sink) => sink.flush(),
        }
    }

    /// Write everything out and end the file as its format asks.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Candump(mut log) => log.flush(),
            Self::Mcap(sink) => Ok(sink.finish()?.flush()?),
        }
    }
}

impl CandumpLog {
    fn flush(&mut self) -> Result<()> {
        let mut rest = self.pending.as_slice();
        while let Some(first) = rest.first() {
            let run = rest.iter().take_while(|entry| entry.interface == first.interface).count();
            let mut writer = CandumpWriter::new(&self.file, &first.interface)?;
            for entry in &rest[..run] {
                writer.write(entry.timestamp_us, &entry.frame)?;
            }
            writer.finish()?.flush()?;
            rest = &rest[run..];
        }
        self.pending.clear();
        Ok(())
    }
}
