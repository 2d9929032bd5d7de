//! What the rows reach: one file for each row and seed as it is finished, and all of them together.

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};
use slipsense::params::CLASSES;
use slipsense_synth::Split;
use slipsense_synth::splits::GENERATOR_VERSION;

use super::Row;
use crate::device::DeviceName;
use crate::evaluate::{DetectorFigures, Scores};
use crate::output;

/// What every row gets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Budget {
    pub episodes: usize,
    /// Seed of the training episodes, the same for all rows and seeds.
    pub data_seed: u64,
    /// Version of what made the episodes.
    pub generator: u32,
    pub steps: usize,
    /// Sequences per step.
    pub batch: usize,
    /// Frames per sequence.
    pub frames: usize,
    pub learning_rate: f64,
    /// Steps, sequences and frames of a row with the paper's encoders, and of the encoders' pretraining.
    pub encoder_steps: usize,
    pub encoder_batch: usize,
    pub encoder_frames: usize,
    /// Hash of the authors' SSAST-Tiny; null where it is pretrained here.
    pub ssast_sha256: Option<String>,
    /// First episodes of each frozen split that are scored.
    pub test_episodes: usize,
    /// The same for rows with the paper's encoders, of the two UMI splits alone.
    pub encoder_test_episodes: usize,
    /// First episodes of each validation split that the detector is judged on, and as many of disturbances.
    #[serde(default)]
    pub detector_episodes: usize,
}

/// Of episodes of the generator as it is, seed 1: the small budget.
impl Default for Budget {
    fn default() -> Self {
        Self {
            episodes: 240,
            data_seed: 1,
            generator: GENERATOR_VERSION,
            steps: 480,
            batch: 6,
            frames: 240,
            learning_rate: 3e-3,
            encoder_steps: 30,
            encoder_batch: 2,
            encoder_frames: 60,
            ssast_sha256: None,
            test_episodes: 16,
            encoder_test_episodes: 4,
            detector_episodes: 48,
        }
    }
}

impl Budget {
    /// Refuses a folder of another budget; a new one is marked with this.
    pub(super) fn mark(&self, out: &Path) -> Result<()> {
        let path = out.join("budget.json");
        match output::read_json::<Self>(&path)? {
            Some(other) => other.must_be(self, &path),
            None => output::write_json(&path, self),
        }
    }

    /// Refuses a file that another budget made.
    fn must_be(&self, asked: &Self, path: &Path) -> Result<()> {
        ensure!(
            self == asked,
            "{}: budget is {}, now asked for {}; rows of different budgets do not compare, use another --out",
            path.display(),
            serde_json::to_string(self)?,
            serde_json::to_string(asked)?
        );
        Ok(())
    }
}

/// Figures of one row and seed on one split; null where there is nothing to divide by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SplitFigures {
    pub split: Split,
    pub episodes: usize,
    pub frames: u64,
    pub events: usize,
    /// Mean F1 of the three classes.
    pub macro_f1: Option<f64>,
    /// Share of frames whose class is right.
    pub accuracy: Option<f64>,
    /// False slip frames of the frames that do not slip.
    pub fpr_of_non_slip_share: Option<f64>,
    /// Median over hits and misses (infinite); null where infinite or without events.
    pub latency_median_frames: Option<f64>,
    /// Frames of every episode, `[episode][truth][predicted]`.
    pub confusion: Vec<[[u64; CLASSES]; CLASSES]>,
}

impl SplitFigures {
    /// Of all episodes' scores together.
    pub fn new(split: Split, episodes: Vec<Scores>) -> Self {
        let confusion: Vec<_> = episodes.iter().map(|scores| scores.classes.confusion).collect();
        let mut scores = Scores::default();
        episodes.into_iter().for_each(|episode| scores.add(episode));
        let figures = scores.figures();
        Self {
            split,
            episodes: confusion.len(),
            frames: figures.frames,
            events: figures.events,
            macro_f1: figures.macro_f1,
            accuracy: figures.accuracy,
            fpr_of_non_slip_share: figures.fpr_of_non_slip,
            latency_median_frames: figures.median_latency_frames,
            confusion,
        }
    }
}

/// What a network says of every frame of the first episode of `umi_ood`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Example {
    pub label: Vec<u8>,
    /// As it is scored.
    pub class: Vec<u8>,
    /// Of the three classes, 0 to 1.
    pub slip_probability: Vec<f32>,
}

/// A row and seed that is done, as in `DIR/ROW-SEED.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finished {
    pub row: String,
    /// Seed of first weights and draws.
    pub seed: u64,
    /// All figures are of generated episodes.
    pub synthetic: bool,
    pub budget: Budget,
    /// What trained and ran it.
    #[serde(default)]
    pub device: DeviceName,
    /// Trained numbers.
    pub parameters: usize,
    /// Training loss at the end, nat; null for a row that is not trained.
    pub loss: Option<f64>,
    /// Training and scoring, seconds.
    pub wall_s: f64,
    /// The whole network on one window of two sensors in contact, on this computer, ms; null where no episode slips.
    pub window_ms: Option<f64>,
    pub splits: Vec<SplitFigures>,
    /// Of rows with our encoders and with pads, which it needs, on validation data at ten false alarms per hour.
    pub detector: Option<DetectorFigures>,
    /// Of the rows that the picture of an episode shows.
    pub example: Option<Example>,
}

impl Finished {
    pub fn path(out: &Path, row: &str, seed: u64) -> PathBuf {
        out.join(format!("{row}-{seed}.json"))
    }

    /// What an earlier run left; none if there is nothing. Refuses what had another budget.
    pub fn read(out: &Path, row: &str, seed: u64, budget: &Budget) -> Result<Option<Self>> {
        let path = Self::path(out, row, seed);
        let Some(done) = output::read_json::<Self>(&path)? else { return Ok(None) };
        done.budget.must_be(budget, &path)?;
        Ok(Some(done))
    }

    pub fn write(&self, out: &Path) -> Result<()> {
        output::write_json(&Self::path(out, &self.row, self.seed), self)
    }
}

/// A figure over the seeds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    pub mean: f64,
    pub lowest: f64,
    pub highest: f64,
}

impl Spread {
    /// None where there is no seed or one of them has no figure.
    pub fn new(seeds: impl IntoIterator<Item = Option<f64>>) -> Option<Self> {
        let values: Vec<f64> = seeds.into_iter().collect::<Option<_>>()?;
        let lowest = values.iter().copied().reduce(f64::min)?;
        let highest = values.iter().copied().reduce(f64::max)?;
        Some(Self { mean: values.iter().sum::<f64>() / values.len() as f64, lowest, highest })
    }
}

/// One row over all its seeds, on one split.
#[derive(Clone, Debug, Serialize)]
pub struct RowSplit {
    pub split: Split,
    pub events: usize,
    pub macro_f1: Option<Spread>,
    pub accuracy: Option<Spread>,
    pub fpr_of_non_slip_share: Option<Spread>,
    pub latency_median_frames: Option<Spread>,
}

/// One row over all its seeds.
#[derive(Clone, Debug, Serialize)]
pub struct RowResults {
    pub row: &'static str,
    pub group: &'static str,
    pub about: &'static str,
    pub parameters: usize,
    pub window_ms: Option<Spread>,
    /// Of all seeds.
    pub devices: Vec<DeviceName>,
    /// What the detector misses, a share; null where a seed has no figure.
    pub detector_missed: Option<Spread>,
    pub splits: Vec<RowSplit>,
    pub seeds: Vec<Finished>,
}

impl RowResults {
    /// None without a finished seed.
    pub(super) fn new(row: &'static Row, finished: &[Finished]) -> Option<Self> {
        let mut seeds: Vec<Finished> = finished.iter().filter(|done| done.row == row.name).cloned().collect();
        seeds.sort_by_key(|done| done.seed);
        let first = seeds.first()?;
        let split = |(index, figures): (usize, &SplitFigures)| {
            let of = |figure: fn(&SplitFigures) -> Option<f64>| {
                Spread::new(seeds.iter().map(|seed| seed.splits.get(index).and_then(figure)))
            };
            RowSplit {
                split: figures.split,
                events: figures.events,
                macro_f1: of(|f| f.macro_f1),
                accuracy: of(|f| f.accuracy),
                fpr_of_non_slip_share: of(|f| f.fpr_of_non_slip_share),
                latency_median_frames: of(|f| f.latency_median_frames),
            }
        };
        Some(Self {
            row: row.name,
            group: row.group,
            about: row.about,
            parameters: first.parameters,
            window_ms: Spread::new(seeds.iter().map(|seed| seed.window_ms)),
            devices: [DeviceName::Cpu, DeviceName::Gpu]
                .into_iter()
                .filter(|device| seeds.iter().any(|seed| seed.device == *device))
                .collect(),
            detector_missed: Spread::new(seeds.iter().map(|seed| seed.detector?.missed)),
            splits: first.splits.iter().enumerate().map(split).collect(),
            seeds,
        })
    }

    /// Macro F1, the mean over some splits, over the seeds.
    pub fn macro_f1(&self, splits: &[Split]) -> Option<Spread> {
        let of_seed = |seed: &Finished| {
            let figures = splits.iter().map(|split| seed.splits.iter().find(|f| f.split == *split)?.macro_f1);
            let figures: Vec<f64> = figures.collect::<Option<_>>()?;
            Some(figures.iter().sum::<f64>() / figures.len() as f64)
        };
        Spread::new(self.seeds.iter().map(of_seed))
    }
}
