//! Real recordings in generated training episodes: motion and knocks, and what measured surfaces sound like, so that
//! neither has to be modelled.
//!
//! The recordings are public and not kept here: `docs/src/model/training.md` says where they come from.

use std::f64::consts::TAU;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use slipsense::params::XL_RATE_HZ;
use slipsense_recording::Episode;
use slipsense_recording::npz::Reader;

/// Arrays of motion.npz: acceleration in g, `[sample][axis]`, 8 kHz.
const RECORDINGS: [&str; 4] = ["stwinbox_usb", "stwinbox_sd", "stwin_usb", "stwin_sd"];
/// Arrays of surfaces.npz: height along a line, every [`PITCH_MM`].
const SURFACES: [&str; 12] = [
    "acrylic",
    "bass_wood",
    "ceramic",
    "plywood",
    "polycarbonate",
    "polyethylene",
    "poplar_wood",
    "pvc",
    "rough_wood",
    "sanded_acrylic",
    "sandpaper",
    "vinyl",
];
const PITCH_MM: f64 = 5.576_272e-3;
/// Share of the episodes that get recorded motion, and of those whose slips get a measured surface.
const MOVED: f64 = 0.3;
const TEXTURED: f64 = 0.3;
/// Smallest and largest factor on motion: how near it happens.
const MOTION_GAIN: std::ops::Range<f64> = 0.05..1.5;
/// Smallest and largest vibration of a surface at 10 mm/s, g rms, of which each sensor gets 0.3 to 1; proportional to a
/// power of the speed.
const TEXTURE_G: std::ops::Range<f64> = 0.01..1.0;
const SPEED_EXPONENT: std::ops::Range<f64> = 0.4..1.2;

#[derive(Clone, Debug)]
pub struct RealParts {
    recordings: Vec<Vec<[f32; 3]>>,
    surfaces: Vec<Surface>,
}

/// Slopes of a surface, unit rms.
#[derive(Clone, Debug)]
struct Surface(Vec<f64>);

impl Surface {
    fn new(heights: &[f32]) -> Self {
        let slope: Vec<f64> = heights.windows(2).map(|h| f64::from(h[1] - h[0])).collect();
        let rms = (slope.iter().map(|x| x * x).sum::<f64>() / slope.len() as f64).sqrt().max(1e-12);
        Self(slope.into_iter().map(|x| x / rms).collect())
    }

    /// Under a finger that has slid so far; the surface begins anew where it ends.
    fn at(&self, mm: f64) -> f64 {
        let x = mm / PITCH_MM;
        let [near, far] = [0, 1].map(|next| self.0[(x as usize + next) % self.0.len()]);
        near + (far - near) * x.fract()
    }
}

fn log_uniform(rng: &mut ChaCha8Rng, range: &std::ops::Range<f64>) -> f64 {
    rng.random_range(range.start.ln()..range.end.ln()).exp()
}

/// Arrays of these names and of the shape that `words` say.
fn arrays(
    path: &Path,
    names: &[&'static str],
    shape: &[Option<usize>],
    words: &str,
) -> Result<Vec<Vec<f32>>> {
    let mut file = Reader::open(path)?;
    let array = |&name: &&'static str| {
        let array = file.array::<f32>(name)?;
        array.require_shape(shape, words)?;
        let values = array.read()?;
        ensure!(values.len() > 1, "array `{name}` is empty");
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            bail!("array `{name}`: value {at} is {}, must be finite", values[at]);
        }
        Ok(values)
    };
    names.iter().map(array).collect()
}

impl RealParts {
    pub fn read(folder: &Path) -> Result<Self> {
        let read = |name: &str, names: &[&'static str], shape: &[Option<usize>], words: &str| {
            let path = folder.join(name);
            arrays(&path, names, shape, words).with_context(|| path.display().to_string())
        };
        let motion = read("motion.npz", &RECORDINGS, &[None, Some(3)], "[N, 3]")?;
        let heights = read("surfaces.npz", &SURFACES, &[None], "[N]")?;
        Ok(Self {
            recordings: motion.iter().map(|values| values.as_chunks().0.to_vec()).collect(),
            surfaces: heights.iter().map(|heights| Surface::new(heights)).collect(),
        })
    }

    /// Add motion to the accelerometers of some episodes, and a measured surface to the slips of some. The draws follow
    /// from the episode's seed.
    pub fn add(&self, episode: &mut Episode) {
        let seed = episode.meta.other.get("seed").and_then(Value::as_u64).unwrap_or_default();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if rng.random_bool(MOVED) {
            self.add_motion(&mut rng, episode);
        }
        rng.set_stream(1);
        if rng.random_bool(TEXTURED) {
            self.add_surface(&mut rng, episode);
        }
    }

    /// The same recording for all sensors from a random place on, again and again, with axes exchanged and reversed and
    /// a gain that differs by sensor.
    fn add_motion(&self, rng: &mut ChaCha8Rng, episode: &mut Episode) {
        let recording = &self.recordings[rng.random_range(0..self.recordings.len())];
        let start = rng.random_range(0..recording.len());
        let near = log_uniform(rng, &MOTION_GAIN);
        let lsb_g = episode.meta.xl_lsb_g;
        for samples in &mut episode.xl {
            let gain = near * rng.random_range(0.3..1.0) / lsb_g;
            let (turn, signs) = (rng.random_range(0..3), rng.random_range(0..8u8));
            for (index, sample) in samples.iter_mut().enumerate() {
                let moved = recording[(start + index) % recording.len()];
                for (axis, value) in sample.iter_mut().enumerate() {
                    let sign = if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
                    add_lsb(value, sign * gain * f64::from(moved[(axis + turn) % 3]));
                }
            }
        }
    }

    /// What a stiff finger feels of one surface, read at the slid length, each sensor along a line and a direction of
    /// its own.
    fn add_surface(&self, rng: &mut ChaCha8Rng, episode: &mut Episode) {
        let (Some(speed_mm_s), Some(fraction)) = (&episode.slip_true_mm_s, &episode.slip_fraction) else {
            return;
        };
        let surface = &self.surfaces[rng.random_range(0..self.surfaces.len())];
        let level = log_uniform(rng, &TEXTURE_G) / episode.meta.xl_lsb_g;
        let exponent = rng.random_range(SPEED_EXPONENT);
        let length_mm = PITCH_MM * surface.0.len() as f64;
        for (sensor, samples) in episode.xl.iter_mut().enumerate() {
            let gain = level * rng.random_range(0.3..1.0);
            let (z, turn) = (rng.random_range(-1.0..1.0f64), rng.random_range(0.0..TAU));
            let across = (1.0 - z * z).sqrt();
            let direction = [across * turn.cos(), across * turn.sin(), z];
            let mut path_mm = rng.random_range(0.0..length_mm);
            let ends = episode.xl_end.iter().skip(sensor).step_by(episode.sensors);
            let mut from = 0;
            for ((&end, &speed), &share) in ends.zip(speed_mm_s).zip(fraction) {
                let (speed, share) = (f64::from(speed), f64::from(share));
                let gain = gain * share * (speed / 10.0).powf(exponent);
                for sample in &mut samples[from..end as usize] {
                    path_mm += speed / XL_RATE_HZ as f64;
                    let value = gain * surface.at(path_mm);
                    sample.iter_mut().zip(direction).for_each(|(out, axis)| add_lsb(out, axis * value));
                }
                from = end as usize;
            }
        }
    }
}

/// Saturates as the part does.
fn add_lsb(value: &mut i16, more: f64) {
    *value = (f64::from(*value) + more).round().clamp(i16::MIN.into(), i16::MAX.into()) as i16;
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use slipsense_recording::Meta;
    use slipsense_recording::npz::write_file;

    fn parts() -> RealParts {
        RealParts {
            recordings: vec![vec![[1.0, -2.0, 0.5], [40.0, -40.0, 0.0]]],
            surfaces: vec![Surface::new(&[0.0, 1.0, 0.0, -1.0])],
        }
    }

    /// Add the parts to an episode with many seeds; `check` sees each. The ones that were changed are three in ten.
    fn three_in_ten_change(parts: &RealParts, plain: Episode, check: impl Fn(&Episode)) {
        let mut changed = 0;
        for seed in 0..200 {
            let mut episode = plain.clone();
            episode.meta.other.insert("seed".into(), seed.into());
            parts.add(&mut episode);
            check(&episode);
            changed += usize::from(episode.xl != plain.xl);
        }
        assert!((40..80).contains(&changed), "{changed} of 200");
    }

    #[test]
    fn motion_is_added_to_some_episodes_and_saturates() {
        let (xl, meta) = (vec![vec![[0; 3]; 100]; 2], Meta::nominal(1e-3));
        let (parts, ends) = (parts(), Cell::new([false; 2]));
        three_in_ten_change(&parts, Episode { sensors: 2, xl, meta, ..Episode::default() }, |episode| {
            let again = parts.recordings[0].len();
            assert!(episode.xl.iter().all(|xl| xl[0] == xl[again]), "the recording goes on from its start");
            let has = |end| episode.xl.iter().flatten().flatten().any(|&lsb| lsb == end);
            let [low, high] = ends.get();
            ends.set([low || has(i16::MIN), high || has(i16::MAX)]);
        });
        assert_eq!(ends.get(), [true; 2], "40 g");
    }

    #[test]
    fn a_surface_is_felt_in_slips_only() {
        let parts = RealParts { recordings: vec![vec![[0.0; 3]]], ..parts() };
        let one_frame_at_rest_and_one_of_slip = Episode {
            sensors: 2,
            xl: vec![vec![[0; 3]; 66]; 2],
            xl_end: vec![33, 33, 66, 66],
            slip_true_mm_s: Some(vec![0.0, 25.0]),
            slip_fraction: Some(vec![0.0, 1.0]),
            meta: Meta::nominal(1e-5),
            ..Episode::default()
        };
        three_in_ten_change(&parts, one_frame_at_rest_and_one_of_slip, |episode| {
            let [(rest, a), (rest_b, b)] = [0, 1].map(|sensor| episode.xl[sensor].split_at(33));
            assert!(rest.iter().chain(rest_b).all(|sample| *sample == [0; 3]), "at rest");
            let silent = a.iter().all(|sample| *sample == [0; 3]);
            assert!(silent || a != b, "each sensor feels a line of its own");
        });
    }

    #[test]
    fn what_is_wrong_with_a_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = || format!("{:#}", RealParts::read(folder.path()).unwrap_err());
        assert!(error().contains("motion.npz"), "{}", error());
        let motion = |shape: &[usize], value: f32| {
            write_file(folder.path().join("motion.npz"), |file| {
                RECORDINGS.into_iter().try_for_each(|name| file.array(name, shape, [value; 6]))
            })
            .unwrap();
        };
        motion(&[3, 2], 0.0);
        assert!(error().contains("shape is [3, 2], must be [N, 3]"), "{}", error());
        motion(&[2, 3], f32::NAN);
        assert!(error().contains("`stwinbox_usb`: value 0 is NaN, must be finite"), "{}", error());
        motion(&[2, 3], 0.0);
        assert!(error().contains("surfaces.npz"), "{}", error());
    }
}
