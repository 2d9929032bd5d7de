//! Recordings of a bus as files, read and written entry by entry: their length does not matter.

use std::fs::File;
use std::io::{BufReader, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, ensure};

use crate::candump::{CandumpReader, CandumpWriter, Rule};
use crate::mcap_file::{McapSink, McapSource};
pub use crate::recording::{Format, Record, Recording};
use crate::whole_file::write_whole;

/// A file's entries in its order. Nothing comes after an error.
pub struct Reader {
    path: PathBuf,
    source: Source,
    /// Has an entry come yet?
    any: bool,
    done: bool,
}

enum Source {
    Candump { lines: CandumpReader<BufReader<File>>, skipped: u64 },
    Mcap(Box<McapSource<BufReader<File>>>),
}

/// Open a recording.
pub fn open(path: &Path, format: Format) -> Result<Reader> {
    let open = || -> Result<Source> {
        let file = File::open(path).context("cannot read")?;
        let about = file.metadata().context("cannot read")?;
        ensure!(!about.is_dir(), "is a folder, must be a recording");
        let (length, input) = (about.len(), BufReader::new(file));
        Ok(match format {
            Format::Candump => Source::Candump { lines: CandumpReader::new(input), skipped: 0 },
            Format::Mcap => Source::Mcap(Box::new(McapSource::new(input, length))),
        })
    };
    let source = open().with_context(|| path.display().to_string())?;
    Ok(Reader { path: path.to_owned(), source, any: false, done: false })
}

/// Read a recording into memory.
pub fn read(path: &Path, format: Format) -> Result<Recording> {
    let (mut reader, mut recording) = (open(path, format)?, Recording::default());
    for record in &mut reader {
        match record? {
            Record::Frame(entry) => recording.entries.push(entry),
            Record::Displacement { timestamp_us, mm } => recording.displacement.push((timestamp_us, mm)),
        }
    }
    recording.notes = reader.notes();
    Ok(recording)
}

impl Reader {
    /// What the file has and an entry cannot hold, or what is wrong with it, in words; complete at the end.
    pub fn notes(&self) -> Vec<String> {
        match &self.source {
            Source::Candump { skipped: 0, .. } => Vec::new(),
            Source::Candump { skipped, .. } => {
                vec![format!("{skipped} frames that are not CAN FD with a 29-bit identifier are left out")]
            }
            Source::Mcap(source) => source.notes(),
        }
    }
}

impl Iterator for Reader {
    type Item = Result<Record>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.done {
            return None;
        }
        let next = match &mut self.source {
            Source::Candump { lines, skipped } => next_line(lines, skipped),
            Source::Mcap(source) => source.next(),
        };
        let next = match next {
            None if !self.any => Some(Err(anyhow!("no CAN FD frame with a 29-bit identifier in it"))),
            next => next,
        };
        self.any = true;
        self.done = !matches!(next, Some(Ok(_)));
        next.map(|record| record.with_context(|| self.path.display().to_string()))
    }
}

fn next_line(lines: &mut CandumpReader<BufReader<File>>, skipped: &mut u64) -> Option<Result<Record>> {
    loop {
        match lines.next()? {
            Ok(entry) => return Some(Ok(Record::Frame(entry))),
            Err(error) if matches!(error.rule, Rule::NotOurs) => *skipped += 1,
            Err(error) => return Some(Err(error.into())),
        }
    }
}

/// A file in the making.
pub struct Sink<'f> {
    path: &'f Path,
    form: Form<'f>,
    /// Entries that the format does not have.
    left_out: u64,
}

enum Form<'f> {
    Candump(CandumpWriter<&'f mut File>),
    Mcap(Box<McapSink<BufWriter<&'f mut File>>>),
}

impl Sink<'_> {
    pub fn put(&mut self, record: &Record) -> Result<()> {
        let put = match (&mut self.form, record) {
            (Form::Candump(log), Record::Frame(entry)) => log.write_entry(entry).map_err(Into::into),
            (Form::Candump(_), Record::Displacement { .. }) => {
                self.left_out += 1;
                Ok(())
            }
            (Form::Mcap(sink), Record::Frame(entry)) => sink.write(entry),
            (Form::Mcap(sink), Record::Displacement { timestamp_us, mm }) => {
                sink.displacement(*timestamp_us, *mm)
            }
        };
        put.with_context(|| cannot_write(self.path))
    }
}

/// Write the recording that `fill` puts into the sink; returns what the format cannot carry. An error leaves a file as
/// it was.
pub fn write(
    path: &Path,
    format: Format,
    fill: impl FnOnce(&mut Sink<'_>) -> Result<()>,
) -> Result<Vec<String>> {
    // What `fill` reads may fail as well, which is not the fault of this file.
    let mut filled = Ok(());
    let written = write_whole(path, |file| -> Result<u64> {
        let form = match format {
            Format::Candump => Form::Candump(CandumpWriter::new(file, "can0")?),
            Format::Mcap => Form::Mcap(Box::new(McapSink::new(BufWriter::new(file))?)),
        };
        let mut sink = Sink { path, form, left_out: 0 };
        filled = fill(&mut sink);
        ensure!(filled.is_ok());
        match sink.form {
            Form::Candump(log) => _ = log.finish()?,
            Form::Mcap(sink) => sink.finish()?.flush()?,
        }
        Ok(sink.left_out)
    });
    filled?;
    let left_out = written.with_context(|| cannot_write(path))?;
    Ok((left_out > 0).then(|| "the crosshead's displacement is left out".to_owned()).into_iter().collect())
}

pub(crate) fn cannot_write(path: &Path) -> String {
    format!("{}: cannot write", path.display())
}
