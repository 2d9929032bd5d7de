//! What the accelerometer detectors hear: the last 128 samples after the 10 Hz high-pass, in float.
//!
//! The chain is the module's front end (Butterworth of second order per axis, window of 16 ms, periodic
//! Hann, power summed over the axes), computed in float64 and in g, so that parts of different
//! sensitivity give the same numbers.

use std::f64::consts::{PI, SQRT_2};
use std::sync::Arc;

use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use slipsense::params::{FFT_BINS, HIGHPASS_HZ, XL_AXES, XL_RATE_HZ, XL_WINDOW};
use slipsense::sensor::XlSample;
use slipsense_recording::Episode;

type Axes = [f64; XL_AXES];

/// One sensor's high-pass and window.
#[derive(Clone)]
pub struct Ear {
    highpass: HighPass,
    /// Filtered samples, g, a ring.
    window: [Axes; XL_WINDOW],
    /// Where the next sample goes, which is where the oldest is.
    next: usize,
    fft: Arc<dyn RealToComplex<f64>>,
    hann: Arc<[f64]>,
}

impl Ear {
    /// Nothing heard yet: the window is silence, and the first sample will be taken as gravity.
    pub fn new() -> Self {
        let hann = |n: usize| 0.5 - 0.5 * (2.0 * PI * n as f64 / XL_WINDOW as f64).cos();
        Self {
            highpass: HighPass::new(HIGHPASS_HZ.into(), XL_RATE_HZ.into()),
            window: [[0.0; XL_AXES]; XL_WINDOW],
            next: 0,
            fft: RealFftPlanner::new().plan_fft_forward(XL_WINDOW),
            hann: (0..XL_WINDOW).map(hann).collect(),
        }
    }

    /// Take in samples, oldest first; `lsb_g` is the acceleration of one LSB, g.
    pub fn listen(&mut self, samples: &[XlSample], lsb_g: f64) {
        for sample in samples {
            self.window[self.next] = self.highpass.step(sample.map(|x| f64::from(x) * lsb_g));
            self.next = (self.next + 1) % XL_WINDOW;
        }
    }

    /// Take in what this sensor delivered for a frame.
    pub fn listen_to(&mut self, episode: &Episode, frame: usize, sensor: usize) {
        self.listen(episode.xl_batch(frame, sensor), episode.meta.xl_lsb_g);
    }

    /// |X|² of the Hann-windowed last 128 samples, summed over the axes, g²; bins of 62.5 Hz, DC and
    /// Nyquist included.
    pub fn power_g2(&self) -> [f64; FFT_BINS] {
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

    /// Mean square of the last 128 samples without a window, summed over the axes, g².
    pub fn mean_square_g2(&self) -> f64 {
        self.window.iter().flatten().map(|x| x * x).sum::<f64>() / XL_WINDOW as f64
    }
}

impl Default for Ear {
    fn default() -> Self {
        Self::new()
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
