//! The accelerometer's spectrum as the analytic detectors use it, in float64 and in g, so that parts of
//! different sensitivity give the same numbers.
//!
//! The chain is the module's front end: 10 Hz Butterworth high-pass of second order per axis, window of 16 ms,
//! periodic Hann, power summed over the axes. Mel-frequency cepstral coefficients (MFCC) follow Yoo et al. (2021)
//! and the paper's accelerometer baseline: 13 of 26 triangles of height 1 on the HTK mel scale, 20 to 4000 Hz
//! (librosa's `htk=True, norm=None`), natural log, orthonormal DCT-II. `tests/python/check_baselines.py` checks
//! them against librosa.

use std::f64::consts::{PI, SQRT_2};
use std::sync::{Arc, LazyLock};

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use slipsense::params::{FFT_BINS, HIGHPASS_HZ, XL_AXES, XL_RATE_HZ, XL_WINDOW};
use slipsense::sensor::XlSample;
use slipsense_recording::Episode;
use slipsense_recording::mel_point_hz;

pub(crate) const FILTERS: usize = 26;
/// Cepstral coefficients kept, the 0th (level) included.
pub(crate) const COEFFICIENTS: usize = 13;
/// Added under the logarithm, g²: 0.4 LSB² of the coarser part (0.488 mg), and 30 dB below the 9e-5 that
/// 22 µg/√Hz of sensor noise make in one bin of one axis.
const FLOOR_G2: f64 = 1e-7;

type Axes = [f64; XL_AXES];

/// High-pass and the last 128 filtered samples of one sensor.
#[derive(Clone)]
pub(crate) struct XlSpectrum {
    highpass: HighPass,
    /// Filtered samples, g, a ring.
    window: [Axes; XL_WINDOW],
    /// Where the next sample goes, which is where the oldest is.
    next: usize,
    fft: Arc<dyn RealToComplex<f64>>,
    hann: Arc<[f64]>,
}

/// An empty window; the first sample will be taken as gravity.
impl Default for XlSpectrum {
    fn default() -> Self {
        let hann = |n: usize| 0.5 - 0.5 * (2.0 * PI * n as f64 / XL_WINDOW as f64).cos();
        Self {
            highpass: HighPass::new(HIGHPASS_HZ.into(), XL_RATE_HZ.into()),
            window: [[0.0; XL_AXES]; XL_WINDOW],
            next: 0,
            fft: RealFftPlanner::new().plan_fft_forward(XL_WINDOW),
            hann: (0..XL_WINDOW).map(hann).collect(),
        }
    }
}

impl XlSpectrum {
    /// Take samples, oldest first; `lsb_g` is the acceleration of one LSB, g.
    pub(crate) fn push(&mut self, samples: &[XlSample], lsb_g: f64) {
        for sample in samples {
            self.window[self.next] = self.highpass.step(sample.map(|x| f64::from(x) * lsb_g));
            self.next = (self.next + 1) % XL_WINDOW;
        }
    }

    pub(crate) fn push_frame(&mut self, episode: &Episode, frame: usize, sensor: usize) {
        self.push(episode.xl_batch(frame, sensor), episode.meta.xl_lsb_g);
    }

    /// |X|² of the Hann-windowed last 128 samples, summed over the axes, g²; bins of 62.5 Hz, DC and
    /// Nyquist included.
    pub(crate) fn power_g2(&self) -> [f64; FFT_BINS] {
        let mut power = [0.0; FFT_BINS];
        let (mut time, mut bins) = ([0.0; XL_WINDOW], [Complex::default(); FFT_BINS]);
        let mut scratch = [Complex::default(); XL_WINDOW];
        let scratch = &mut scratch[..self.fft.get_scratch_len()];
        for axis in 0..XL_AXES {
            let (newer, older) = self.window.split_at(self.next);
            for ((time, sample), hann) in time.iter_mut().zip(older.iter().chain(newer)).zip(&*self.hann) {
                *time = sample[axis] * hann;
            }
            let transformed = self.fft.process_with_scratch(&mut time, &mut bins, scratch);
            transformed.expect("the buffers have the plan's lengths");
            for (power, bin) in power.iter_mut().zip(&bins) {
                *power += bin.norm_sqr();
            }
        }
        power
    }

    /// Natural log of the mean square of the last 128 samples without a window, summed over the axes, ln g².
    pub(crate) fn log_level(&self) -> f64 {
        let mean_square_g2 = self.window.iter().flatten().map(|x| x * x).sum::<f64>() / XL_WINDOW as f64;
        (mean_square_g2 + FLOOR_G2).ln()
    }

    /// Natural log of the power under each triangle, ln g².
    pub(crate) fn log_mel(&self) -> [f64; FILTERS] {
        let (bank, power_g2) = (&*BANK, self.power_g2());
        std::array::from_fn(|i| {
            let Filter { first_bin, weights } = &bank[i];
            let power: f64 = weights.iter().zip(&power_g2[*first_bin..]).map(|(w, p)| w * p).sum();
            (power + FLOOR_G2).ln()
        })
    }

    /// The first 13 coefficients of the orthonormal DCT-II of the log-mel powers.
    pub(crate) fn mfcc(&self) -> [f64; COEFFICIENTS] {
        let (dct, log_mel) = (&*DCT, self.log_mel());
        std::array::from_fn(|k| dct[k].iter().zip(&log_mel).map(|(d, l)| d * l).sum())
    }
}

/// Butterworth high-pass of second order on three axes at once, by the bilinear transform.
#[derive(Clone, Debug)]
struct HighPass {
    gain: f64,
    a1: f64,
    a2: f64,
    /// The last two inputs and outputs; `None` before the first sample.
    past: Option<[Axes; 4]>,
}

impl HighPass {
    fn new(corner_hz: f64, rate_hz: f64) -> Self {
        let k = (PI * corner_hz / rate_hz).tan();
        let norm = 1.0 / (1.0 + SQRT_2 * k + k * k);
        Self { gain: norm, a1: 2.0 * (k * k - 1.0) * norm, a2: (1.0 - SQRT_2 * k + k * k) * norm, past: None }
    }

    /// The first sample is taken as the value there has always been, so gravity makes no step.
    fn step(&mut self, x: Axes) -> Axes {
        let [x1, x2, y1, y2] = self.past.unwrap_or([x, x, [0.0; XL_AXES], [0.0; XL_AXES]]);
        let y: Axes = std::array::from_fn(|i| {
            self.gain * (x[i] - 2.0 * x1[i] + x2[i]) - self.a1 * y1[i] - self.a2 * y2[i]
        });
        self.past = Some([x, x1, y, y1]);
        y
    }
}

struct Filter {
    first_bin: usize,
    weights: Vec<f64>,
}

static BANK: LazyLock<Vec<Filter>> = LazyLock::new(|| {
    let edge = |i: usize| mel_point_hz(i, FILTERS);
    let bin_hz = f64::from(XL_RATE_HZ) / XL_WINDOW as f64;
    (0..FILTERS)
        .map(|i| {
            let [left, peak, right] = [edge(i), edge(i + 1), edge(i + 2)];
            let weight = |bin: usize| {
                let hz = bin as f64 * bin_hz;
                ((hz - left) / (peak - left)).min((right - hz) / (right - peak)).max(0.0)
            };
            let inside: Vec<usize> = (0..FFT_BINS).filter(|&bin| weight(bin) > 0.0).collect();
            let weights = inside.iter().map(|&bin| weight(bin)).collect();
            Filter { first_bin: inside.first().copied().unwrap_or(0), weights }
        })
        .collect()
});

static DCT: LazyLock<[[f64; FILTERS]; COEFFICIENTS]> = LazyLock::new(|| {
    std::array::from_fn(|k| {
        let scale = (if k == 0 { 1.0 } else { 2.0 } / FILTERS as f64).sqrt();
        std::array::from_fn(|n| scale * (PI * k as f64 * (2 * n + 1) as f64 / (2 * FILTERS) as f64).cos())
    })
});
