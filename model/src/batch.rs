//! Random stretches of episodes as training batches, balanced over hold, slip and onset.

use anyhow::{Result, ensure};
use rand::seq::SliceRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use slipsense::params::{CLASSES, MEL_BINS, PIEZO_CHANNELS, TAXELS, XL_FEATURES};
use slipsense_recording::score::SLIP;

use crate::augment::{MelChange, PadChange, SlowArray, Sound};
use crate::data::Features;
use crate::float::Sequences;
use crate::pad_view::PadView;
use crate::piezo::IMAGE;
use crate::target::Target;

/// What a sequence is drawn around: a frame of a class, one of the first of a slip, or one of a mined stretch.
const GROUPS: usize = CLASSES + 2;
/// How often each is drawn. No contact is the least: the others' sequences contain it as well.
const SHARES: [u32; GROUPS] = [1, 5, 2, 4, 4];
/// Frames that count as the first of a slip: those that decide how fast it is noticed.
const ONSET_FRAMES: usize = 30;
/// How often each is drawn where [contact is learned](Options::learns_contact), %.
const SHARES_WITH_CONTACT: [u32; GROUPS] = [45, 17, 18, 20, 0];

/// What a frame without contact counts in the loss: the pads decide it by themselves.
const NO_CONTACT_WEIGHT: f32 = 0.2;
/// What the first frames of a slip and of another class count, and how many: they decide latency and false alarms.
const ONSET_WEIGHT: f32 = 5.0;
const CHANGE_WEIGHT: f32 = 3.0;
const CHANGE_FRAMES: usize = 12;
/// What the last frames before a slip count, and how many: the interface gives way before the label says so.
const BEFORE_WEIGHT: f32 = 0.2;
const BEFORE_FRAMES: usize = 4;
/// Frames at the start of a sequence cut out of an episode that do not count: their past is missing.
const COLD_FRAMES: usize = 20;

/// What the sequences hold; the default is what the shipped network is trained on.
#[derive(Clone, Copy, Debug)]
pub struct Options {
    pub pads: PadView,
    /// Whether what the accelerometers hear is changed at random.
    pub xl_augmentation: bool,
    /// See [`Sequences::extreme_weight`].
    pub extreme_weight: Option<f32>,
    /// Whether contact is learned too, so that frames without it count as much as others.
    pub learns_contact: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            pads: PadView::default(),
            xl_augmentation: true,
            extreme_weight: Some(2.0),
            learns_contact: false,
        }
    }
}

/// Draws batches from a set of episodes.
#[derive(Debug)]
pub struct Sampler<'e> {
    episodes: Vec<&'e Features>,
    sensors: usize,
    frames: usize,
    options: Options,
    /// Episode and frame of every frame of each group.
    groups: [Vec<(u32, u32)>; GROUPS],
}

impl<'e> Sampler<'e> {
    /// Stretches of `frames` frames. All episodes must have as many sensors and be that long; every class must occur.
    pub fn new(
        episodes: impl IntoIterator<Item = &'e Features>,
        frames: usize,
        options: Options,
    ) -> Result<Self> {
        let episodes: Vec<_> = episodes.into_iter().collect();
        let sensors = episodes.first().map_or(0, |e| e.sensors);
        let mut groups: [Vec<(u32, u32)>; GROUPS] = Default::default();
        for (index, episode) in episodes.iter().enumerate() {
            let (own, length) = (episode.sensors, episode.frames());
            ensure!(own == sensors, "training episode {index} has {own} sensors, the first has {sensors}");
            ensure!(
                length >= frames,
                "training episode {index} has {length} frames, fewer than a sequence of {frames}"
            );
            if episode.mined {
                groups[CLASSES + 1].extend((0..length).map(|frame| (index as u32, frame as u32)));
                continue;
            }
            for (frame, &class) in episode.label.iter().enumerate() {
                groups[class as usize].push((index as u32, frame as u32));
                let before = &episode.label[frame.saturating_sub(ONSET_FRAMES)..frame];
                let slides_anew = episode.target[frame] == Target::Slides
                    && frame
                        .checked_sub(ONSET_FRAMES)
                        .is_none_or(|early| episode.target[early] != Target::Slides);
                if (class == SLIP && before.iter().any(|&class| class != SLIP)) || slides_anew {
                    groups[CLASSES].push((index as u32, frame as u32));
                }
            }
        }
        for (class, frames) in groups.iter().take(CLASSES).enumerate() {
            ensure!(!frames.is_empty(), "no training frame has label {class}");
        }
        ensure!(!groups[CLASSES].is_empty(), "no training episode holds the onset of a slip");
        Ok(Self { episodes, sensors, frames, options, groups })
    }

    pub fn class_frames(&self) -> [usize; CLASSES] {
        std::array::from_fn(|class| self.groups[class].len())
    }

    /// The batch of a seed. All its sequences have as many sensors: all in half of the cases, else 1 to all.
    pub fn batch(&self, sequences: usize, seed: u64) -> Sequences {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let seeds: Vec<u64> = (0..sequences).map(|_| rng.random()).collect();
        let all = rng.random_bool(0.5);
        let sensors = if all { self.sensors } else { rng.random_range(1..=self.sensors) };
        let mut batch = Sequences {
            batch: sequences,
            sensors,
            frames: self.frames,
            piezo: vec![0; sequences * sensors * self.frames * IMAGE],
            xl: vec![0.0; sequences * sensors * self.frames * XL_FEATURES],
            target: vec![Target::Either; sequences * self.frames],
            extreme_weight: self.options.extreme_weight,
            label: vec![0; sequences * self.frames],
            weight: vec![0.0; sequences * self.frames],
            taught: Vec::new(),
        };
        seeds
            .into_par_iter()
            .zip(batch.piezo.par_chunks_exact_mut(sensors * self.frames * IMAGE))
            .zip(batch.xl.par_chunks_exact_mut(sensors * self.frames * XL_FEATURES))
            .zip(batch.label.par_chunks_exact_mut(self.frames))
            .zip(batch.target.par_chunks_exact_mut(self.frames))
            .zip(batch.weight.par_chunks_exact_mut(self.frames))
            .for_each(|(((((seed, piezo), xl), label), target), weight)| {
                let start = self.sequence(seed, piezo, xl, (label, target));
                let no_contact = if self.options.learns_contact { 1.0 } else { NO_CONTACT_WEIGHT };
                weigh(label, start, no_contact, weight);
                if start > 0 {
                    target[..COLD_FRAMES.min(self.frames)].fill(Target::Either);
                }
            });
        batch
    }

    /// A changed stretch of some sensors around a random frame of a random group; returns its start in the episode.
    fn sequence(
        &self,
        seed: u64,
        piezo: &mut [i16],
        xl: &mut [f32],
        (label, target): (&mut [u8], &mut [Target]),
    ) -> usize {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let shares = if self.options.learns_contact { SHARES_WITH_CONTACT } else { SHARES };
        let there = || self.groups.iter().zip(shares).filter(|(frames, _)| !frames.is_empty());
        let dice = rng.random_range(0..there().map(|(_, share)| share).sum::<u32>());
        let mut shares = there().flat_map(|(frames, share)| std::iter::repeat_n(frames, share as usize));
        let frames = shares.nth(dice as usize).expect("there are as many shares");
        let (episode, frame) = frames[rng.random_range(0..frames.len())];
        let episode = self.episodes[episode as usize];
        let before = rng.random_range(0..self.frames);
        let start = (frame as usize).saturating_sub(before).min(episode.frames() - self.frames);

        let mut order: Vec<usize> = (0..self.sensors).collect();
        order.shuffle(&mut rng);
        // Drawn in any case: with and without them the same stretches, sensors and pads are drawn.
        let (sound, changes_xl) = (Sound::draw(self.frames, &mut rng), self.options.xl_augmentation);
        let sound = if changes_xl { sound } else { Sound::default() };
        let sensors = piezo.chunks_exact_mut(self.frames * IMAGE);
        let mut present = vec![false; self.sensors];
        let parts = xl.chunks_exact_mut(self.frames * XL_FEATURES);
        for ((&sensor, piezo), xl) in order.iter().zip(sensors).zip(parts) {
            present[sensor] = true;
            let (pad, mel) = (PadChange::draw(&mut rng), MelChange::draw(&mut rng));
            let slow = SlowArray::draw(&mut rng);
            let mel = if changes_xl { mel } else { MelChange::NONE };
            let mut view = self.options.pads.start();
            let mut counts = [0; TAXELS];
            let bins = (start..start + self.frames).flat_map(|t| &episode.reading(t, sensor).ln_power);
            let mean = bins.sum::<f32>() / (self.frames * MEL_BINS) as f32;
            let passed = if episode.mined { usize::MAX } else { start };
            let mut floor = mel.floor(&episode.reading(start, sensor).floor, passed, (&sound, mean));
            let frames = piezo.chunks_exact_mut(IMAGE).zip(xl.chunks_exact_mut(XL_FEATURES));
            for (t, (piezo, xl)) in frames.enumerate() {
                let reading = |t: usize| episode.reading((start + t).min(episode.frames() - 1), sensor);
                let scans = slow.scans(t).map(|t| reading(t).scan());
                pad.apply(scans, slow.between(t), &mut counts, &mut rng);
                let cells = piezo.as_chunks_mut::<PIEZO_CHANNELS>().0;
                view.push(&counts, |index, cell| cells[index] = cell);
                mel.apply(&reading(t).ln_power, &mut floor, (&sound, mean, t), xl, &mut rng);
            }
        }
        for (t, (label, target)) in label.iter_mut().zip(target).enumerate() {
            *label = episode.label_for(start + t, &present);
            *target = episode.target_for(start + t, &present);
        }
        start
    }
}

/// What the frames of a sequence that begins at frame `start` of its episode count in the loss.
fn weigh(label: &[u8], start: usize, no_contact: f32, weight: &mut [f32]) {
    for (t, weight) in weight.iter_mut().enumerate() {
        let changed = (t.saturating_sub(CHANGE_FRAMES)..t).any(|u| label[u] != label[u + 1]);
        let soon = label[t] != SLIP && label[t..].iter().take(BEFORE_FRAMES + 1).any(|&l| l == SLIP);
        *weight = if start > 0 && t < COLD_FRAMES {
            0.0
        } else if soon {
            BEFORE_WEIGHT
        } else if label[t] == 0 {
            no_contact
        } else if changed && label[t] == SLIP {
            ONSET_WEIGHT
        } else if changed {
            CHANGE_WEIGHT
        } else {
            1.0
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_by_hand() {
        let mut label = vec![1u8; 100];
        label[50..60].fill(SLIP);
        label[90..].fill(0);
        let mut weight = vec![9.0; 100];
        weigh(&label, 5, NO_CONTACT_WEIGHT, &mut weight);
        assert!(weight[..COLD_FRAMES].iter().all(|&w| w == 0.0));
        assert_eq!(weight[COLD_FRAMES..45].iter().sum::<f32>(), (45 - COLD_FRAMES) as f32);
        assert_eq!(weight[45..53], [1.0, 0.2, 0.2, 0.2, 0.2, 5.0, 5.0, 5.0]);
        // Slip for 10 frames, then 12 after its end.
        assert_eq!((weight[59], weight[71], weight[72]), (5.0, 3.0, 1.0));
        assert_eq!((weight[89], weight[95]), (1.0, 0.2));
        weigh(&label, 0, NO_CONTACT_WEIGHT, &mut weight);
        assert_eq!(weight[0], 1.0);
    }
}
