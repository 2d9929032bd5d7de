//! Writing archives: the same arrays give the same bytes, and a file appears whole or not at all.

use super::{CHUNK_BYTES, Scalar, header};
use crate::whole_file::write_whole;
use crate::{EpisodeError, Problem};
use std::io::{self, Cursor, Seek, Write};
use std::path::Path;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, System, ZipWriter};

/// Entries from this size on get 64-bit sizes; a deflated entry can be slightly larger than its data.
const LARGE_BYTES: u64 = 4_000_000_000;

/// Measured on synthetic episodes of two sensors: 8 ms per second of signal and 226 kB; level 6 takes
/// 22 ms for 209 kB, level 1 5 ms for 381 kB.
const LEVEL: i64 = 3;

pub struct Writer<W: Write + Seek> {
    zip: ZipWriter<W>,
}

impl<W: Write + Seek> Writer<W> {
    pub fn new(to: W) -> Self {
        Self { zip: ZipWriter::new(to) }
    }

    /// Append one array, C order, deflated.
    pub fn array<T: Scalar>(
        &mut self,
        name: &'static str,
        shape: &[usize],
        values: impl IntoIterator<Item = T>,
    ) -> Result<(), Problem> {
        let elements: usize = shape.iter().product();
        // Date, system and level are set because their defaults depend on the machine and on which
        // features of the zip crate the rest of the build turns on.
        let options = SimpleFileOptions::default()
            .compression_method(CompressionMethod::Deflated)
            .compression_level(Some(LEVEL))
            .last_modified_time(DateTime::default())
            .system(System::Unix)
            .unix_permissions(0o644)
            .large_file((elements * size_of::<T>()) as u64 > LARGE_BYTES);
        self.zip.start_file(format!("{name}.npy"), options).map_err(io::Error::from)?;
        self.zip.write_all(&header::write(T::DESCR, shape))?;
        let mut chunk = Vec::with_capacity(CHUNK_BYTES);
        let mut written = 0;
        for value in values {
            chunk.extend_from_slice(bytemuck::bytes_of(&value.swap_le()));
            written += 1;
            if chunk.len() >= CHUNK_BYTES {
                self.zip.write_all(&chunk)?;
                chunk.clear();
            }
        }
        self.zip.write_all(&chunk)?;
        if written != elements {
            return Err(Problem::array(name, format!("{written} values given for shape {shape:?}")));
        }
        Ok(())
    }

    /// Write the archive's directory and hand back what it was written to.
    pub fn finish(self) -> Result<W, Problem> {
        self.zip.finish().map_err(|e| Problem::Write(e.into()))
    }
}

/// Write a file with `fill`; an error leaves the file as it was.
pub fn write_file(
    path: impl AsRef<Path>,
    fill: impl FnOnce(&mut Writer<Cursor<Vec<u8>>>) -> Result<(), Problem>,
) -> Result<(), EpisodeError> {
    let path = path.as_ref();
    let written = write_whole(path, |file| {
        // Through memory: an archive dropped on a full disk complains on standard error by itself.
        let mut writer = Writer::new(Cursor::new(Vec::new()));
        fill(&mut writer)?;
        file.write_all(&writer.finish()?.into_inner()).map_err(Problem::Write)
    });
    written.map_err(|problem| problem.at(path))
}
