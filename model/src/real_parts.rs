//! Recorded motion in generated training episodes: knocks and handling that nobody had to model.
//!
//! The recordings are public and not kept here: `docs/src/model/training.md` says where they come from.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;
use slipsense_recording::Episode;
use slipsense_recording::npz::Reader;

/// Arrays of the file: acceleration in g, `[sample][axis]`, 8 kHz.
const RECORDINGS: [&str; 4] = ["stwinbox_usb", "stwinbox_sd", "stwin_usb", "stwin_sd"];
/// Share of the episodes that get recorded motion.
const MOVED: f64 = 0.3;
/// Smallest and largest factor on it: how near it happens.
const GAIN: std::ops::Range<f64> = 0.05..1.5;

#[derive(Clone, Debug)]
pub struct Motion {
    recordings: Vec<Vec<[f32; 3]>>,
}

impl Motion {
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join("motion.npz");
        let read = || -> Result<_> {
            let mut file = Reader::open(&path)?;
            let recording = |name| {
                let array = file.array::<f32>(name)?;
                array.require_shape(&[None, Some(3)], "[N, 3]")?;
                let values = array.read()?;
                ensure!(!values.is_empty(), "array `{name}` is empty");
                Ok(values.as_chunks().0.to_vec())
            };
            RECORDINGS.into_iter().map(recording).collect()
        };
        Ok(Self { recordings: read().with_context(|| path.display().to_string())? })
    }

    /// Add motion to the accelerometers of some episodes: the same recording for all sensors from a random place on,
    /// again and again, with axes exchanged and reversed and a gain that differs by sensor. The draws follow from the
    /// episode's seed.
    pub fn add(&self, episode: &mut Episode) {
        let seed = episode.meta.other.get("seed").and_then(Value::as_u64).unwrap_or_default();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        if !rng.random_bool(MOVED) {
            return;
        }
        let recording = &self.recordings[rng.random_range(0..self.recordings.len())];
        let start = rng.random_range(0..recording.len());
        let near = rng.random_range(GAIN.start.ln()..GAIN.end.ln()).exp();
        let lsb_g = episode.meta.xl_lsb_g;
        for samples in &mut episode.xl {
            let gain = near * rng.random_range(0.3..1.0) / lsb_g;
            let (turn, signs) = (rng.random_range(0..3), rng.random_range(0..8u8));
            for (index, sample) in samples.iter_mut().enumerate() {
                let moved = recording[(start + index) % recording.len()];
                for (axis, value) in sample.iter_mut().enumerate() {
                    let sign = if signs >> axis & 1 == 1 { -1.0 } else { 1.0 };
                    let sum = f64::from(*value) + sign * gain * f64::from(moved[(axis + turn) % 3]);
                    *value = sum.round().clamp(i16::MIN.into(), i16::MAX.into()) as i16;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense_recording::Meta;

    #[test]
    fn motion_is_added_to_some_episodes_and_saturates() {
        let motion = Motion { recordings: vec![vec![[1.0, -2.0, 0.5], [40.0, -40.0, 0.0]]] };
        let still = Episode {
            sensors: 2,
            xl: vec![vec![[0; 3]; 100]; 2],
            meta: Meta::nominal(1e-3),
            ..Episode::default()
        };
        let mut moved = 0;
        for seed in 0..200 {
            let mut episode = still.clone();
            episode.meta.other.insert("seed".into(), seed.into());
            motion.add(&mut episode);
            moved += usize::from(episode.xl != still.xl);
            let again = motion.recordings[0].len();
            assert!(episode.xl.iter().all(|xl| xl[0] == xl[again]), "the recording goes on from its start");
        }
        assert!((40..80).contains(&moved), "{moved} of 200");
    }

    #[test]
    fn a_folder_without_recordings_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = format!("{:#}", Motion::read(folder.path()).unwrap_err());
        assert!(error.contains("motion.npz"), "{error}");
    }
}
