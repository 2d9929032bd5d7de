//! What sliding does to the pressure below the size of a taxel: the hundreds of asperities under one
//! element carry its share of the load unevenly, and others take over as the faces slide by their own
//! size. A sliding contact flickers, a sticking one keeps the flicker it stopped at, unless the grip force
//! changes: then the pad bulges, and the faces shift against each other without slip.

use libm::{exp, log, sqrt};
use serde::Serialize;
use slipsense::params::TAXELS;

use super::map::PressureMap;
use crate::draw::{Draw, Rng};

/// Relative rms of one element's pressure, lowest and highest: about a third of `1/√n` for the `n`
/// asperities of 10–40 µm that fit under the 0.45 × 0.45 mm of an element, as the layer between spreads their
/// loads. A modelling range, set so that the paper's baselines land where they do in the paper.
const RMS: (f64, f64) = (0.0075, 0.03);
/// How far the faces shift against each other while the grip force grows or falls e-fold: a layer of rubber bulges by
/// tenths of its thickness of some millimetres. A modelling range, as the one above.
const BULGE_MM: (f64, f64) = (0.1, 0.6);

#[derive(Serialize)]
pub(crate) struct AsperityNoise {
    rms: f64,
    /// Slid length after which other asperities carry the load, mm.
    length_mm: f64,
    bulge_mm: f64,
    #[serde(skip)]
    state: Box<[f64; TAXELS]>,
    #[serde(skip)]
    path_mm: f64,
    /// Force of the pressures before, N; 0 for none.
    #[serde(skip)]
    force_n: f64,
}

impl AsperityNoise {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        Self {
            rms: rng.uniform(RMS),
            length_mm: rng.log_between(0.01, 0.04),
            bulge_mm: rng.log_uniform(BULGE_MM),
            state: Box::new([0.0; TAXELS]),
            path_mm: 0.0,
            force_n: 0.0,
        }
    }

    /// Change the pressures of a patch that has slid `path_mm` in all (load-weighted); their sum stays.
    pub(crate) fn apply(&mut self, path_mm: f64, rng: &mut Rng, map: &mut PressureMap) {
        let force_n = map.force_n();
        let before_n = std::mem::replace(&mut self.force_n, force_n);
        if force_n <= 0.0 {
            return;
        }
        let bulged_mm = if before_n > 0.0 { self.bulge_mm * log(force_n / before_n).abs() } else { 0.0 };
        let slid_mm = path_mm - self.path_mm + bulged_mm;
        self.path_mm = path_mm;
        if slid_mm > 0.0 {
            let keep = exp(-slid_mm / self.length_mm);
            let fresh = sqrt(1.0 - keep * keep);
            for &cell in &map.loaded {
                self.state[cell] = keep * self.state[cell] + fresh * rng.normal();
            }
        }
        for &cell in &map.loaded {
            map.kpa[cell] *= (1.0 + self.rms * self.state[cell]).max(0.0);
        }
        map.carry(force_n);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::check::{near, within};
    use crate::draw::{Stream, stream};

    #[test]
    fn it_flickers_only_while_sliding_and_keeps_the_force() {
        let mut rng = stream(5, Stream::Contact, 0);
        let mut grain = AsperityNoise::draw(&mut rng);
        let even = || {
            let mut map = PressureMap::empty();
            for cell in 300..700 {
                map.kpa[cell] = 40.0;
                map.loaded.push(cell);
            }
            map
        };
        let mut step = |path_mm: f64| {
            let mut map = even();
            grain.apply(path_mm, &mut rng, &mut map);
            map
        };
        let (rest, slid) = (step(0.0), step(1.0));
        let held = step(1.0);
        let moved = step(1.0 + 2.0 / 240.0);
        let change = |a: &PressureMap, b: &PressureMap| {
            let of = |c: &usize| a.kpa[*c] / b.kpa[*c] - 1.0;
            let sum: f64 = a.loaded.iter().map(|c| of(c) * of(c)).sum();
            (sum / a.loaded.len() as f64).sqrt()
        };
        near("force, N", slid.force_n(), even().force_n(), 1e-12);
        assert_eq!(change(&held, &slid), 0.0);
        within("relative rms change, slid 1 mm", change(&slid, &rest), RMS.0 * 0.9..RMS.1 * 1.1);
        within("one frame at 2 mm/s", change(&moved, &held), 0.005..);
    }
}
