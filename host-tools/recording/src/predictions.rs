//! What the pipeline said about an episode, as a file.

use crate::npz::{Reader, Scalar, write_file};
use crate::{EpisodeError, Problem};
use slipsense::features::{LN_FRAC_BITS, LogMel, STANDARDISED_FRAC_BITS};
use slipsense::fixed::Logit;
use slipsense::params::{CLASSES, MEL_BINS};
use slipsense::pipeline::Output;
use std::io::{Read, Seek};
use std::path::Path;

/// The pipeline's output for every frame of an episode; a file has an array of each field's name and type, shape \[F\],
/// logits \[F, 3\], log-mel \[F, S, 16\].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Predictions {
    /// Sensors, 1 to 3.
    pub sensors: usize,
    /// Class per frame: 0 no contact, 1 no slip, 2 slip.
    pub class: Vec<u8>,
    /// Logits per frame, Q10.
    pub logits: Vec<[i32; CLASSES]>,
    /// The detector's log-odds of slip per frame, Q10; the least `i32` where no pad is touched.
    pub log_odds: Vec<i32>,
    /// Whether slip may begin, as sent, 0 or 1, per frame.
    pub may_begin: Vec<u8>,
    /// The flag to act on, as sent, 0 or 1, per frame.
    pub slip: Vec<u8>,
    /// Natural log of the axis-summed mel power in g², `[frame * sensors + sensor]`, before
    /// standardisation.
    pub logmel: Vec<[f32; MEL_BINS]>,
    /// What the network sees: `logmel` standardised over its bins, `[frame * sensors + sensor]`.
    pub logmel_std: Vec<[f32; MEL_BINS]>,
}

/// Log-mel power in physical units: natural log of g², from the Q16 logarithm of LSB².
pub fn logmel_g2(log_mel: &LogMel, xl_lsb_g: f64) -> [f32; MEL_BINS] {
    let unit = 2.0 * xl_lsb_g.ln();
    log_mel.ln_power.map(|q| (f64::from(q) / f64::from(1 << LN_FRAC_BITS) + unit) as f32)
}

/// Standardised log-mel as a number: exact, the fixed-point value has 16 bits.
pub fn logmel_std(log_mel: &LogMel) -> [f32; MEL_BINS] {
    log_mel.standardised.map(|q| f32::from(q) / f32::from(1i16 << STANDARDISED_FRAC_BITS))
}

impl Predictions {
    /// Of no frame yet.
    pub fn new(sensors: usize) -> Self {
        Self { sensors, ..Self::default() }
    }

    /// What the pipeline said about the next frame; `xl_lsb_g`: unit of the samples.
    pub fn push(&mut self, output: &Output, xl_lsb_g: f64) {
        self.class.push(output.class as u8);
        self.logits.push(output.logits.map(Logit::to_bits));
        self.log_odds.push(output.log_odds.map_or(i32::MIN, Logit::to_bits));
        self.may_begin.push(output.may_begin.into());
        self.slip.push(output.slip.into());
        for log_mel in output.log_mel.iter().take(self.sensors) {
            self.logmel.push(logmel_g2(log_mel, xl_lsb_g));
            self.logmel_std.push(logmel_std(log_mel));
        }
    }

    pub fn frames(&self) -> usize {
        self.class.len()
    }

    /// Read a `predictions.npz` and check its shapes.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, EpisodeError> {
        let path = path.as_ref();
        Reader::open(path).and_then(from_archive).map_err(|problem| problem.at(path))
    }

    /// Write a deflated `.npz` file. The same predictions give the same bytes; an error leaves the file as it was.
    pub fn write(&self, path: impl AsRef<Path>) -> Result<(), EpisodeError> {
        let frames = self.frames();
        let mel = [frames, self.sensors, MEL_BINS];
        write_file(path, |npz| {
            npz.array("class", &[frames], self.class.iter().copied())?;
            npz.array("logits", &[frames, CLASSES], self.logits.iter().flatten().copied())?;
            npz.array("log_odds", &[frames], self.log_odds.iter().copied())?;
            npz.array("may_begin", &[frames], self.may_begin.iter().copied())?;
            npz.array("slip", &[frames], self.slip.iter().copied())?;
            npz.array("logmel", &mel, self.logmel.iter().flatten().copied())?;
            npz.array("logmel_std", &mel, self.logmel_std.iter().flatten().copied())
        })
    }
}

fn from_archive<R: Read + Seek>(mut npz: Reader<R>) -> Result<Predictions, Problem> {
    let class = npz.array::<u8>("class")?;
    class.require_shape(&[None], "[F]")?;
    let frames = class.shape()[0];
    let class = class.read()?;
    let mel = npz.array::<f32>("logmel")?;
    let words = format!("[F, S, {MEL_BINS}] with F = {frames} as in `class`");
    mel.require_shape(&[Some(frames), None, Some(MEL_BINS)], &words)?;
    let sensors = mel.shape()[1];
    let logmel = rows(mel.read()?);
    Ok(Predictions {
        sensors,
        class,
        logits: rows(read(&mut npz, "logits", &[frames, CLASSES])?),
        log_odds: read(&mut npz, "log_odds", &[frames])?,
        may_begin: read(&mut npz, "may_begin", &[frames])?,
        slip: read(&mut npz, "slip", &[frames])?,
        logmel,
        logmel_std: rows(read(&mut npz, "logmel_std", &[frames, sensors, MEL_BINS])?),
    })
}

fn read<T: Scalar, R: Read + Seek>(
    npz: &mut Reader<R>,
    name: &'static str,
    shape: &[usize],
) -> Result<Vec<T>, Problem> {
    let array = npz.array(name)?;
    let must: Vec<_> = shape.iter().copied().map(Some).collect();
    array.require_shape(&must, &format!("{shape:?}"))?;
    array.read()
}

fn rows<T: Copy, const N: usize>(values: Vec<T>) -> Vec<[T; N]> {
    values.as_chunks().0.to_vec()
}
