//! Random draws: every part of an episode has its own stream of one seed, and a change in one leaves the others alone.

use libm::{exp, log};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// The generator: ChaCha, because its output is specified and the same on every machine.
pub(crate) type Rng = ChaCha8Rng;

#[derive(Clone, Copy)]
pub(crate) enum Stream {
    Recipe = 1,
    Scenario = 2,
    Grasp = 3,
    Script = 4,
    Mount = 5,
    Unit = 16,
    Contact = 32,
    Friction = 48,
    Film = 64,
    Vibration = 80,
    Accelerometer = 96,
    Encoder = 112,
    Motion = 128,
    Trial = 144,
    Families = 160,
    Object = 176,
}

/// The draws of one part; `sensor` keeps the sensors apart and is 0 for what they share.
pub(crate) fn stream(seed: u64, part: Stream, sensor: usize) -> Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(part as u64 + sensor as u64);
    rng
}

pub(crate) type Span = (f64, f64);

pub(crate) trait Draw: rand::Rng {
    /// Uniform in `lo..hi`.
    fn between(&mut self, lo: f64, hi: f64) -> f64 {
        lo + (hi - lo) * self.random::<f64>()
    }
    fn log_between(&mut self, lo: f64, hi: f64) -> f64 {
        exp(self.between(log(lo), log(hi)))
    }
    fn uniform(&mut self, (lo, hi): Span) -> f64 {
        self.between(lo, hi)
    }
    fn log_uniform(&mut self, (lo, hi): Span) -> f64 {
        self.log_between(lo, hi)
    }
    /// 1 or −1.
    fn sign(&mut self) -> f64 {
        if self.chance(0.5) { 1.0 } else { -1.0 }
    }
    /// Size uniform in the range, then the sign.
    fn either_sign(&mut self, size: Span) -> f64 {
        self.uniform(size) * self.sign()
    }
    /// Exponential of mean 1, cut off at `−ln(least)`.
    fn exponential(&mut self, least: f64) -> f64 {
        -log(self.between(least, 1.0))
    }
    /// Times of a Poisson process between two times; gaps are [`exponential`](Self::exponential).
    fn moments(&mut self, (from, to): Span, per_s: f64, least: f64) -> Vec<f64> {
        let mut times = Vec::new();
        if per_s > 0.0 {
            let mut t = from + self.exponential(least) / per_s;
            while t < to {
                times.push(t);
                t += self.exponential(least) / per_s;
            }
        }
        times
    }
    /// Gaussian of zero mean and unit variance.
    fn normal(&mut self) -> f64 {
        StandardNormal.sample(self)
    }
    fn chance(&mut self, p: f64) -> bool {
        self.between(0.0, 1.0) < p
    }
    /// Integer in `lo..=hi`.
    fn count(&mut self, lo: usize, hi: usize) -> usize {
        self.random_range(lo..=hi)
    }
    /// Direction, uniform on the sphere.
    fn direction(&mut self) -> [f64; 3] {
        unit_vector([self.normal(), self.normal(), self.normal()])
    }
    fn phase(&mut self) -> f64 {
        self.between(0.0, std::f64::consts::TAU)
    }
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(crate) fn unit_vector(v: [f64; 3]) -> [f64; 3] {
    let norm = v.iter().map(|x| x * x).sum::<f64>().sqrt().max(1e-9);
    v.map(|x| x / norm)
}

impl Draw for Rng {}
