//! A path of decaying random echoes: each axis is convolved with noise of its own that falls exponentially.

use libm::exp;
use serde::Serialize;

use super::scene::Motion;
use crate::draw::{Draw, Rng};

const RATE_HZ: f64 = 8_000.0;

#[derive(Serialize)]
pub(super) struct Echoes {
    /// Until an echo has fallen to a tenth; twice that is kept.
    decay_s: f64,
    /// Weight of the echo before in the next: below 0 it is bright, above 0 dull.
    colour: f64,
    level: f64,
    #[serde(skip)]
    taps: [Vec<f64>; 3],
}

impl Echoes {
    pub fn draw(rng: &mut Rng) -> Self {
        let (decay_s, colour) = (rng.log_between(1e-3, 10e-3), rng.between(-0.6, 0.8));
        let level = rng.log_between(0.4, 1.5);
        let fall = exp(-std::f64::consts::LN_10 / (decay_s * RATE_HZ));
        let taps = std::array::from_fn(|_| {
            let (mut envelope, mut echo) = (1.0, 0.0);
            let mut taps: Vec<f64> = (0..(2.0 * decay_s * RATE_HZ) as usize)
                .map(|_| {
                    echo = colour * echo + rng.normal();
                    envelope *= fall;
                    envelope * echo
                })
                .collect();
            let norm = taps.iter().map(|x| x * x).sum::<f64>().sqrt();
            taps.iter_mut().for_each(|x| *x *= level / norm);
            taps
        });
        Self { decay_s, colour, level, taps }
    }

    pub fn respond(&self, motion: &mut Motion) {
        let source = motion.g.clone();
        for (n, out) in motion.g.iter_mut().enumerate() {
            for (axis, taps) in self.taps.iter().enumerate() {
                let past = source[..=n].iter().rev();
                out[axis] = taps.iter().zip(past).map(|(tap, g)| tap * g[axis]).sum();
            }
        }
    }
}
