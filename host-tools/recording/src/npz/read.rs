//! Reading arrays out of an archive, with nothing taken on trust.

use super::{CHUNK_BYTES, Scalar, header};
use crate::Problem;
use bytemuck::Pod;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::marker::PhantomData;
use std::path::Path;
use zip::read::ZipFile;
use zip::result::ZipError;
use zip::{CompressionMethod, ZipArchive};

/// Most bytes that one deflated byte can stand for: 258 bytes per two bits.
const DEFLATE_RATIO_MAX: u64 = 1032;

pub struct Reader<R> {
    zip: ZipArchive<R>,
    source_bytes: u64,
}

impl Reader<BufReader<File>> {
    pub fn open(path: &Path) -> Result<Self, Problem> {
        let file = File::open(path).map_err(Problem::Read)?;
        if file.metadata().map_err(Problem::Read)?.is_dir() {
            return Err(Problem::Rule("is a folder, must be an .npz file".into()));
        }
        Self::new(BufReader::with_capacity(CHUNK_BYTES, file))
    }
}

impl<R: Read + Seek> Reader<R> {
    pub fn new(mut source: R) -> Result<Self, Problem> {
        let mut start = Vec::new();
        source.by_ref().take(2).read_to_end(&mut start).map_err(Problem::Read)?;
        let source_bytes = source.seek(SeekFrom::End(0)).map_err(Problem::Read)?;
        match &start[..] {
            [] => Err(Problem::Rule("is empty, must be an .npz archive".into())),
            b"PK" => {
                let zip = ZipArchive::new(source)
                    .map_err(|e| Problem::Rule(format!("is a zip archive cut short or damaged: {e}")))?;
                Ok(Self { zip, source_bytes })
            }
            _ => Err(Problem::Rule("is not an .npz (zip) archive".into())),
        }
    }

    pub fn has(&self, name: &str) -> bool {
        self.zip.index_for_name(&entry_name(name)).is_some()
    }

    /// Open an array that must be there.
    pub fn array<T: Scalar>(&mut self, name: &'static str) -> Result<Array<'_, T, R>, Problem> {
        let fail = |rule: String| Problem::array(name, rule);
        let mut entry = match self.zip.by_name(&entry_name(name)) {
            Ok(entry) => entry,
            Err(ZipError::FileNotFound) => return Err(Problem::missing(name)),
            Err(e) => return Err(fail(format!("cannot be unpacked, must be stored or deflated: {e}"))),
        };
        let header = header::read(&mut entry).map_err(fail)?;
        if header.descr != T::DESCR {
            let found: String = header.descr.escape_default().take(40).collect();
            return Err(fail(format!("dtype is '{found}', must be {} ('{}')", T::NAME, T::DESCR)));
        }
        if header.fortran_order {
            return Err(fail("is in Fortran order, must be in C order (numpy.ascontiguousarray)".into()));
        }
        let bytes_held = entry.size().saturating_sub(header.bytes);
        let elements = elements_if_held::<T>(&header.shape, bytes_held).ok_or_else(|| {
            fail(format!("shape is {:?}, but the data is {bytes_held} bytes", header.shape))
        })?;
        let packed = entry.compressed_size().min(self.source_bytes);
        let bytes_max = match entry.compression() {
            CompressionMethod::Stored => packed,
            _ => packed.saturating_add(1).saturating_mul(DEFLATE_RATIO_MAX),
        };
        if entry.size() > bytes_max {
            let rule =
                format!("shape is {:?}, more than the file can hold; cut short or damaged", header.shape);
            return Err(fail(rule));
        }
        let shape = header.shape.iter().map(|&n| n as usize).collect();
        Ok(Array { name, shape, elements, entry, scalar: PhantomData })
    }
}

fn entry_name(array: &str) -> String {
    format!("{array}.npy")
}

/// The number of elements of a shape, if it is exactly what `bytes` hold.
fn elements_if_held<T: Scalar>(shape: &[u64], bytes: u64) -> Option<usize> {
    let elements = shape.iter().try_fold(1u64, |product, &n| product.checked_mul(n))?;
    let held = elements.checked_mul(size_of::<T>() as u64)? == bytes;
    // An axis may be huge only where another is 0; both must fit the machine.
    let fits = shape.iter().all(|&n| usize::try_from(n).is_ok());
    if held && fits { usize::try_from(elements).ok() } else { None }
}

/// One array whose dtype has been checked and whose data has not been read yet.
pub struct Array<'a, T, R: Read + Seek> {
    name: &'static str,
    shape: Vec<usize>,
    elements: usize,
    entry: ZipFile<'a, R>,
    scalar: PhantomData<T>,
}

impl<T: Scalar, R: Read + Seek> Array<'_, T, R> {
    /// The shape, slowest axis first.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Check the shape: `None` in `must` is any length. `words` says it for the message.
    pub fn require_shape(&self, must: &[Option<usize>], words: &str) -> Result<(), Problem> {
        let same = self.shape.len() == must.len()
            && self.shape.iter().zip(must).all(|(&n, must)| must.is_none_or(|must| n == must));
        if same {
            return Ok(());
        }
        Err(Problem::array(self.name, format!("shape is {:?}, must be {words}", self.shape)))
    }

    /// Read all elements, C order. The archive's checksum is verified.
    pub fn read(mut self) -> Result<Vec<T>, Problem> {
        let all = self.next(self.elements)?;
        self.end()?;
        Ok(all)
    }

    /// The same of an array `[rows, groups, N]`, each row for itself.
    pub fn read_rows<const N: usize>(mut self) -> Result<Vec<Vec<[T; N]>>, Problem>
    where
        [T; N]: Pod,
    {
        let groups = self.shape[1];
        let rows = (0..self.shape[0]).map(|_| self.next(groups)).collect::<Result<_, _>>()?;
        self.end()?;
        Ok(rows)
    }

    /// The same in blocks of `elements`, each read when it is asked for; the last may be shorter. The checksum
    /// is compared after it.
    pub fn blocks(mut self, elements: usize) -> impl Iterator<Item = Result<Vec<T>, Problem>> {
        let mut left = Some(self.elements);
        std::iter::from_fn(move || {
            let now = left?.min(elements);
            left = left.map(|left| left - now);
            let block = if now > 0 { self.next(now).map(Some) } else { self.end().map(|()| None) };
            if !matches!(block, Ok(Some(_))) {
                left = None;
            }
            block.transpose()
        })
    }

    /// The next `count` elements, or groups of elements, read in place: an hour's samples are half a gigabyte. Memory is
    /// touched as data come, whatever the shape says.
    fn next<V: Pod>(&mut self, count: usize) -> Result<Vec<V>, Problem> {
        let mut values = Vec::new();
        values.try_reserve_exact(count).map_err(|_| {
            Problem::array(self.name, format!("shape is {:?}, more than memory holds", self.shape))
        })?;
        while values.len() < count {
            let start = values.len();
            values.resize(count.min(start + (CHUNK_BYTES / size_of::<V>()).max(1)), V::zeroed());
            let new = &mut values[start..];
            self.entry.read_exact(bytemuck::cast_slice_mut(new)).map_err(|e| self.damaged(&e))?;
            for value in bytemuck::cast_slice_mut::<V, T>(new) {
                *value = value.swap_le();
            }
        }
        Ok(values)
    }

    /// Nothing follows. Reading past the end is what makes the zip reader compare the checksum.
    fn end(&mut self) -> Result<(), Problem> {
        match self.entry.read(&mut [0]).map_err(|e| self.damaged(&e))? {
            0 => Ok(()),
            _ => Err(Problem::array(self.name, format!("shape is {:?}, but more data follows", self.shape))),
        }
    }

    fn damaged(&self, error: &io::Error) -> Problem {
        Problem::array(self.name, format!("data is cut short or damaged: {error}"))
    }
}
