//! Random stretches of episodes as training batches, balanced over hold, slip and onset.

use anyhow::{Result, ensure};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use slipsense::params::{CLASSES, MEL_BINS, TAXELS};
use slipsense_episode::score::SLIP;

use crate::augment::{MelChange, PadChange};
use crate::data::Features;
use crate::float::Sequences;

/// What a sequence is drawn around: a frame of a class, or one of the first after the onset of a slip.
const GROUPS: usize = CLASSES + 1;
/// How often each is drawn. No contact is the least: the pads decide it by themselves, and sequences
/// around the others contain it as well.
const SHARES: [u32; GROUPS] = [1, 2, 2, 2];
/// Frames that count as the first of a slip: those that decide how fast it is noticed.
const ONSET_FRAMES: usize = 30;

/// Draws batches from a set of episodes.
#[derive(Debug)]
pub struct Sampler<'e> {
    episodes: &'e [Features],
    sensors: usize,
    frames: usize,
    /// Episode and frame of every frame of each group.
    groups: [Vec<(u32, u32)>; GROUPS],
}

impl<'e> Sampler<'e> {
    /// Stretches of `frames` frames. All episodes must have the same number of sensors and be at least
    /// that long, and every class must occur.
    pub fn new(episodes: &'e [Features], frames: usize) -> Result<Self> {
        let sensors = episodes.first().map_or(0, |e| e.sensors);
        let mut groups: [Vec<(u32, u32)>; GROUPS] = Default::default();
        for (index, episode) in episodes.iter().enumerate() {
            ensure!(
                episode.sensors == sensors,
                "training episode {index} has {} sensors, the first has {sensors}",
                episode.sensors
            );
            ensure!(
                episode.frames() >= frames,
                "training episode {index} has {} frames, fewer than a sequence of {frames}",
                episode.frames()
            );
            for (frame, &class) in episode.label.iter().enumerate() {
                groups[class as usize].push((index as u32, frame as u32));
                let before = &episode.label[frame.saturating_sub(ONSET_FRAMES)..frame];
                if class == SLIP && before.iter().any(|&class| class != SLIP) {
                    groups[CLASSES].push((index as u32, frame as u32));
                }
            }
        }
        for (class, frames) in groups.iter().take(CLASSES).enumerate() {
            ensure!(!frames.is_empty(), "no training frame has label {class}");
        }
        ensure!(!groups[CLASSES].is_empty(), "no training episode holds the onset of a slip");
        Ok(Self { episodes, sensors, frames, groups })
    }

    /// Frames of each class.
    pub fn class_frames(&self) -> [usize; CLASSES] {
        std::array::from_fn(|class| self.groups[class].len())
    }

    /// One batch; the same seed draws the same one. All its sequences have the same number of sensors:
    /// all in half of the cases, else a number from 1 to all, drawn evenly.
    pub fn batch(&self, sequences: usize, seed: u64) -> Sequences {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let seeds: Vec<u64> = (0..sequences).map(|_| rng.random()).collect();
        let all = rng.random_bool(0.5);
        let sensors = if all { self.sensors } else { rng.random_range(1..=self.sensors) };
        let mut batch = Sequences {
            batch: sequences,
            sensors,
            frames: self.frames,
            piezo: vec![0.0; sequences * sensors * self.frames * TAXELS],
            log_mel: vec![0.0; sequences * sensors * self.frames * MEL_BINS],
            label: vec![0; sequences * self.frames],
        };
        seeds
            .into_par_iter()
            .zip(batch.piezo.par_chunks_exact_mut(sensors * self.frames * TAXELS))
            .zip(batch.log_mel.par_chunks_exact_mut(sensors * self.frames * MEL_BINS))
            .zip(batch.label.par_chunks_exact_mut(self.frames))
            .for_each(|(((seed, piezo), log_mel), label)| self.sequence(seed, piezo, log_mel, label));
        batch
    }

    /// One stretch around a random frame of a random group, of some of the sensors, changed at random.
    fn sequence(&self, seed: u64, piezo: &mut [f32], log_mel: &mut [f32], label: &mut [u8]) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut dice = rng.random_range(0..SHARES.iter().sum());
        let group = SHARES.iter().position(|&share| match dice.checked_sub(share) {
            Some(rest) => {
                dice = rest;
                false
            }
            None => true,
        });
        let frames = &self.groups[group.unwrap_or_default()];
        let (episode, frame) = frames[rng.random_range(0..frames.len())];
        let episode = &self.episodes[episode as usize];
        let before = rng.random_range(0..self.frames);
        let start = (frame as usize).saturating_sub(before).min(episode.frames() - self.frames);

        let mut order: Vec<usize> = (0..self.sensors).collect();
        order.shuffle(&mut rng);
        let sensors = piezo.chunks_exact_mut(self.frames * TAXELS);
        let mut present = vec![false; self.sensors];
        for ((&sensor, piezo), log_mel) in
            order.iter().zip(sensors).zip(log_mel.chunks_exact_mut(self.frames * MEL_BINS))
        {
            present[sensor] = true;
            let (pad, mel) = (PadChange::draw(&mut rng), MelChange::draw(&mut rng));
            let frames = piezo.chunks_exact_mut(TAXELS).zip(log_mel.chunks_exact_mut(MEL_BINS));
            for (t, (piezo, log_mel)) in frames.enumerate() {
                pad.apply(episode.scan(start + t, sensor), piezo, &mut rng);
                mel.apply(episode.log_mel(start + t, sensor), log_mel, &mut rng);
            }
        }
        for (t, label) in label.iter_mut().enumerate() {
            *label = episode.label_for(start + t, &present);
        }
    }
}
