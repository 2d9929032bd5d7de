//! Episodes as files: which array holds which field, and the rules that show only there.

use crate::npz::{Reader, Scalar, write_file};
use crate::{Episode, EpisodeError, Meta, Problem};
use slipsense::params::{MAX_SENSORS, TAXEL_COLS, TAXEL_ROWS, TAXELS, XL_AXES};
use slipsense::sensor::{PiezoFrame, TaxelError};
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

impl Episode {
    /// Read an `.npz` file, stored or deflated, and check every rule of the format.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, EpisodeError> {
        let path = path.as_ref();
        Reader::open(path).and_then(from_archive).map_err(|problem| problem.at(path))
    }

    /// Read an `.npz` file held in memory; `name` stands for the file in error messages.
    pub fn from_bytes(bytes: &[u8], name: impl AsRef<Path>) -> Result<Self, EpisodeError> {
        Reader::new(Cursor::new(bytes)).and_then(from_archive).map_err(|problem| problem.at(name.as_ref()))
    }

    /// Check the rules, then write a deflated `.npz` file. The same episode gives the same bytes; an
    /// error leaves the file as it was.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), EpisodeError> {
        let (frames, sensors) = (self.frames(), self.sensors);
        write_file(path, |npz| {
            self.validate()?;
            let counts = self.piezo.iter().flat_map(|scan| scan.counts().iter().copied());
            npz.array("piezo", &[frames, sensors, TAXEL_ROWS, TAXEL_COLS], counts)?;
            let samples = self.xl.iter().flatten().flatten().copied();
            npz.array("xl", &[sensors, self.xl[0].len(), XL_AXES], samples)?;
            npz.array("xl_end", &[frames, sensors], self.xl_end.iter().copied())?;
            if let Some(label) = &self.label {
                npz.array("label", &[frames], label.iter().copied())?;
            }
            for (array, values) in self.float_arrays() {
                if let Some(values) = values {
                    npz.array(array, &[frames], values.iter().copied())?;
                }
            }
            let json = self.meta.to_json();
            npz.array("meta", &[json.len()], json.bytes())
        })
    }
}

fn from_archive<R: Read + Seek>(npz: Reader<R>) -> Result<Episode, Problem> {
    let mut file = EpisodeReader::from_archive(npz)?;
    let piezo = file.scans()?.1.collect::<Result<_, _>>()?;
    Ok(Episode { piezo, ..file.episode })
}

/// An episode whose scans, nearly all of its bytes, are read one by one: those of an hour do not fit memory.
pub struct EpisodeReader<R> {
    npz: Reader<R>,
    episode: Episode,
}

impl EpisodeReader<BufReader<File>> {
    /// Open an `.npz` file, and read and check all but its scans.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, EpisodeError> {
        let path = path.as_ref();
        Reader::open(path).and_then(Self::from_archive).map_err(|problem| problem.at(path))
    }
}

impl<R: Read + Seek> EpisodeReader<R> {
    /// The same of a file that something else holds; `name` stands for it in error messages.
    pub fn new(source: R, name: impl AsRef<Path>) -> Result<Self, EpisodeError> {
        Reader::new(source).and_then(Self::from_archive).map_err(|problem| problem.at(name.as_ref()))
    }

    /// The episode without its scans.
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// The episode without its scans, and these, each read and checked when it is asked for, `[frame * sensors + sensor]`.
    pub fn scans(
        &mut self,
    ) -> Result<(&Episode, impl Iterator<Item = Result<PiezoFrame, Problem>>), Problem> {
        let sensors = self.episode.sensors;
        let blocks = self.npz.array::<u16>("piezo")?.blocks(TAXELS);
        Ok((&self.episode, blocks.enumerate().map(move |(i, counts)| scan(i, sensors, &counts?))))
    }

    fn from_archive(mut npz: Reader<R>) -> Result<Self, Problem> {
        if let Some(array) = ["piezo", "xl", "xl_end", "meta"].into_iter().find(|array| !npz.has(array)) {
            return Err(Problem::missing(array));
        }
        // First what is small: a file with a wrong unit is refused before its frames are unpacked.
        let meta = npz.array::<u8>("meta")?;
        meta.require_shape(&[None], "[L], the bytes of a JSON text")?;
        let meta = Meta::from_json(&meta.read()?)?;

        let piezo = npz.array::<u16>("piezo")?;
        let words = format!("[F, S, {TAXEL_ROWS}, {TAXEL_COLS}] with S from 1 to {MAX_SENSORS}");
        piezo.require_shape(&[None, None, Some(TAXEL_ROWS), Some(TAXEL_COLS)], &words)?;
        let (frames, sensors) = (piezo.shape()[0], piezo.shape()[1]);
        if !(1..=MAX_SENSORS).contains(&sensors) {
            piezo.require_shape(&[], &words)?;
        }
        drop(piezo);

        let xl = npz.array::<i16>("xl")?;
        xl.require_shape(
            &[Some(sensors), None, Some(XL_AXES)],
            &format!("[S, N, {XL_AXES}] with S = {sensors} as in `piezo`"),
        )?;
        let xl = xl.read_rows()?;

        let xl_end = npz.array::<u32>("xl_end")?;
        let words = format!("[F, S] = [{frames}, {sensors}] as in `piezo`");
        xl_end.require_shape(&[Some(frames), Some(sensors)], &words)?;
        let xl_end = xl_end.read()?;

        let episode = Episode {
            sensors,
            piezo: Vec::new(),
            xl,
            xl_end,
            label: per_frame(&mut npz, "label", frames)?,
            slip_true_mm_s: per_frame(&mut npz, "slip_true", frames)?,
            slip_fraction: per_frame(&mut npz, "slip_fraction", frames)?,
            displacement_mm: per_frame(&mut npz, "displacement_mm", frames)?,
            meta,
        };
        episode.validate_beside(frames * sensors)?;
        Ok(Self { npz, episode })
    }
}

fn per_frame<T: Scalar, R: Read + Seek>(
    npz: &mut Reader<R>,
    name: &'static str,
    frames: usize,
) -> Result<Option<Vec<T>>, Problem> {
    if !npz.has(name) {
        return Ok(None);
    }
    let array = npz.array(name)?;
    array.require_shape(&[Some(frames)], &format!("[F] = [{frames}] as in `piezo`"))?;
    array.read().map(Some)
}

/// Scan number `i` of the file.
fn scan(i: usize, sensors: usize, counts: &[u16]) -> Result<PiezoFrame, Problem> {
    let counts = counts.try_into().map_err(|_| Problem::array("piezo", "ends within a scan"))?;
    PiezoFrame::from_counts(counts).map_err(|error| {
        let (index, count, rule) = match error {
            TaxelError::OutOfRange { index, count } => (index, count, "must be at most 4095"),
            TaxelError::Inactive { index, count } => (index, count, "must be 0, there is no taxel"),
        };
        let position = [i / sensors, i % sensors, index / TAXEL_COLS, index % TAXEL_COLS];
        Problem::element("piezo", &position, count, rule)
    })
}
