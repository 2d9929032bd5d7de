//! A recording in the making, which a kill leaves readable.

use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use crate::candump::{CandumpWriter, LogEntry};
use anyhow::{Context, Result};

use crate::log_file::cannot_write;
use crate::mcap_file::McapSink;
use crate::recording::Format;

/// Writes frames to a file as they come. Everything before the last [`flush`](Self::flush) is on the disk whatever
/// happens, a full disk included.
pub struct Recorder {
    path: PathBuf,
    file: File,
    form: Form,
}

enum Form {
    /// Lines since the last flush, and the file's length then: a log that is cut has whole lines.
    Candump(CandumpWriter<Vec<u8>>, u64),
    Mcap(Box<McapSink<BufWriter<File>>>),
}

impl Recorder {
    /// A new file; one that is there already is refused.
    pub fn create(path: &Path) -> Result<Self> {
        let format = Format::from_path(path)
            .with_context(|| format!("{}: must end in .mcap or .log", path.display()))?;
        let file =
            File::create_new(path).with_context(|| format!("{}: cannot make a new file", path.display()))?;
        let form = match format {
            Format::Mcap => Form::Mcap(Box::new(McapSink::new(BufWriter::new(file.try_clone()?))?)),
            Format::Candump => Form::Candump(CandumpWriter::new(Vec::new(), "can0")?, 0),
        };
        Ok(Self { path: path.to_owned(), file, form })
    }

    pub fn write(&mut self, entry: &LogEntry) -> Result<()> {
        let written = match &mut self.form {
            Form::Candump(lines, _) => lines.write_entry(entry).map_err(Into::into),
            Form::Mcap(sink) => sink.write(entry),
        };
        written.with_context(|| cannot_write(&self.path))
    }

    /// Write everything to the disk; to be called every second or so.
    pub fn flush(&mut self) -> Result<()> {
        let flushed = match &mut self.form {
            Form::Candump(lines, length) => append(&mut self.file, lines, length).map_err(Into::into),
            Form::Mcap(sink) => sink.flush(),
        };
        flushed.and_then(|()| Ok(self.file.sync_data()?)).with_context(|| cannot_write(&self.path))
    }

    /// Write everything out and end the file as its format asks.
    pub fn finish(mut self) -> Result<()> {
        let Form::Mcap(sink) = self.form else { return self.flush() };
        let finished = sink.finish().and_then(|mut out| Ok(out.flush()?));
        finished.and_then(|()| Ok(self.file.sync_data()?)).with_context(|| cannot_write(&self.path))
    }
}

fn append(file: &mut File, lines: &mut CandumpWriter<Vec<u8>>, length: &mut u64) -> std::io::Result<()> {
    let lines = std::mem::take(lines.flushed()?);
    let written = file.write_all(&lines);
    match written {
        Ok(()) => *length += lines.len() as u64,
        // Half of a line could not be read.
        Err(_) => file.set_len(*length)?,
    }
    written
}
