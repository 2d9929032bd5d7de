//! A path of random second-order sections in series on each axis, with cross-talk between the axes before them.

use serde::Serialize;

use super::scene::Motion;
use super::signal::Biquad;
use crate::draw::{Draw, Rng, dot};

#[derive(Clone, Serialize)]
struct Section {
    hz: f64,
    damping: f64,
    /// What it adds at its resonance; either sign.
    gain: f64,
}

#[derive(Serialize)]
pub(super) struct Sections {
    matrix: [[f64; 3]; 3],
    axes: [Vec<Section>; 3],
    /// Share of the difference to the sample before that is added (lifts) or taken away.
    tilt: f64,
}

impl Sections {
    pub fn draw(rng: &mut Rng) -> Self {
        let level = rng.log_between(0.3, 2.0);
        let matrix = std::array::from_fn(|to| {
            std::array::from_fn(|from| level * if to == from { 1.0 } else { 0.5 * rng.between(-1.0, 1.0) })
        });
        let section = |rng: &mut Rng| Section {
            hz: rng.log_between(50.0, 3_600.0),
            damping: rng.log_between(0.02, 0.5),
            gain: rng.either_sign((0.3, 4.0)),
        };
        let count = rng.count(2, 5);
        let axes = std::array::from_fn(|_| (0..count).map(|_| section(rng)).collect());
        Self { matrix, axes, tilt: rng.between(-0.6, 1.5) }
    }

    pub fn respond(&self, motion: &mut Motion) {
        let rate_hz = motion.clock.rate_hz;
        let mut filters = self.axes.clone().map(|sections| {
            let of = |s: &Section| (s.gain, Biquad::bandpass(s.hz.min(0.48 * rate_hz), s.damping, rate_hz));
            sections.iter().map(of).collect::<Vec<_>>()
        });
        let mut before = [0.0; 3];
        for (_, g) in motion.samples() {
            let mixed = self.matrix.map(|row| dot(row, *g));
            for axis in 0..3 {
                let mut y = mixed[axis] + self.tilt * (mixed[axis] - before[axis]);
                for (gain, filter) in &mut filters[axis] {
                    y += *gain * filter.next(y);
                }
                g[axis] = y;
            }
            before = mixed;
        }
    }
}
