//! Episodes to what the network sees, and which of them may be used for what.
//!
//! The split is by object as well as by episode: training never sees an object of the test group, nor
//! one of the validation group. Nothing is chosen by looking at the test group.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use indicatif::ProgressBar;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use slipsense::features::XlFrontEnd;
use slipsense::params::{CONTACT_SUM_MIN, MEL_BINS, TAXELS};
use slipsense_episode::Episode;
use slipsense_synth::{ObjectChoice, Recipe, generate_set, objects};

/// What an episode may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Split {
    /// Gradients and calibration.
    Train,
    /// The curve that a person watches during training.
    Validation,
    /// The figures.
    Test,
}

/// Objects of the catalogue's training group that are kept for validation.
pub const VALIDATION_OBJECTS: [&str; 2] = ["rj45-plug", "spruce-strip"];

/// Seed of the generated test episodes. Fixed, so that the figures of two models compare.
pub const TEST_SEED: u64 = 0x7e58;

/// Turns the training seed into the one of the validation episodes.
const VALIDATION_SALT: u64 = 0x0076_616c;

/// Sensors of a generated episode.
const SENSORS: usize = 2;

/// The split an object belongs to. The catalogue says it for its objects; others, from someone's own
/// recordings, go by a hash of their name: one in four to test, one in eight to validation.
pub fn split_of(object: &str) -> Split {
    match objects::named(object) {
        Some(known) if known.held_out() => Split::Test,
        Some(_) if VALIDATION_OBJECTS.contains(&object) => Split::Validation,
        Some(_) => Split::Train,
        None => match Sha256::digest(object.as_bytes())[0] {
            0..64 => Split::Test,
            64..96 => Split::Validation,
            _ => Split::Train,
        },
    }
}

/// Where episodes come from.
#[derive(Clone, Debug)]
pub enum Source {
    /// Made on the fly by the generator.
    Generated {
        /// Seed of training and validation episodes.
        seed: u64,
    },
    /// All `.npz` files of a folder.
    Folder(PathBuf),
}

impl Source {
    /// A folder where one is named, else the generator.
    pub fn new(folder: Option<&Path>, seed: u64) -> Self {
        folder.map_or(Self::Generated { seed }, |folder| Self::Folder(folder.to_owned()))
    }

    /// Hand every episode of a split to `each`, on all cores; results in a fixed order. `count` is how
    /// many to generate, or the most to take from a folder.
    pub fn map<T: Send>(
        &self,
        split: Split,
        count: usize,
        bar: &ProgressBar,
        each: impl Fn(Episode) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        match self {
            Self::Generated { seed } => {
                let recipes = recipes(split, *seed, count);
                bar.set_length(recipes.len() as u64);
                let results = generate_set(&recipes, |_, episode| {
                    let result = each(episode);
                    bar.inc(1);
                    result
                })?;
                results.into_iter().collect()
            }
            Self::Folder(folder) => {
                let mut files = episode_files(folder, split)?;
                files.truncate(count);
                ensure!(!files.is_empty(), "{}: no episode of the {split:?} group", folder.display());
                bar.set_length(files.len() as u64);
                let one = |path: &PathBuf| {
                    let result = each(Episode::read(path)?).with_context(|| path.display().to_string());
                    bar.inc(1);
                    result
                };
                files.par_iter().map(one).collect()
            }
        }
    }

    /// For the manifest.
    pub fn describe(&self) -> String {
        match self {
            Self::Generated { seed } => format!("synthetic, slipsense-synth, seed {seed}"),
            Self::Folder(folder) => format!("episodes in {}", folder.display()),
        }
    }
}

/// Recipes of generated episodes: the split's objects in turn, everything else drawn.
pub fn recipes(split: Split, seed: u64, count: usize) -> Vec<Recipe> {
    let names: Vec<&str> =
        objects::CATALOGUE.iter().map(|o| o.name).filter(|name| split_of(name) == split).collect();
    let seed = match split {
        Split::Train => seed,
        Split::Validation => seed ^ VALIDATION_SALT,
        Split::Test => TEST_SEED,
    };
    let base = Recipe { sensors: SENSORS, ..Recipe::new(seed) };
    let named = base.series(count).into_iter().zip(names.iter().cycle());
    named.map(|(recipe, name)| Recipe { object: ObjectChoice::Named((*name).to_owned()), ..recipe }).collect()
}

/// The folder's episodes of a split, by name.
fn episode_files(folder: &Path, split: Split) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files = Vec::new();
    for entry in entries {
        let path = entry.with_context(|| format!("cannot read {}", folder.display()))?.path();
        if path.extension().is_some_and(|e| e == "npz") {
            files.push(path);
        }
    }
    ensure!(!files.is_empty(), "{}: no .npz file", folder.display());
    files.sort();
    let mut chosen = Vec::new();
    for path in files {
        let episode = Episode::read(&path)?;
        let Some(object) = episode.meta.other.get("object").and_then(|o| o.as_str()) else {
            bail!("{}: meta has no \"object\", needed to split by object", path.display());
        };
        if split_of(object) == split {
            chosen.push(path);
        }
    }
    Ok(chosen)
}

/// One episode as the network sees it.
#[derive(Clone, Debug)]
pub struct Features {
    /// Sensors.
    pub sensors: usize,
    /// Counts, `[frame][sensor][32 · 32]`.
    pub piezo: Vec<u16>,
    /// Standardised log-mel, Q2.13, `[frame][sensor][16]`.
    pub log_mel: Vec<i16>,
    /// Is the pad touched, `[frame][sensor]`.
    pub touched: Vec<bool>,
    /// Classes, `[frame]`.
    pub label: Vec<u8>,
}

impl Features {
    /// Run the microcontroller's own front end over an episode.
    pub fn from_episode(episode: &Episode) -> Result<Self> {
        let label = episode.label.clone().context("array label is missing, needed for training")?;
        let (frames, sensors) = (episode.frames(), episode.sensors);
        let mut features = Self {
            sensors,
            piezo: Vec::with_capacity(frames * sensors * TAXELS),
            log_mel: Vec::with_capacity(frames * sensors * MEL_BINS),
            touched: Vec::with_capacity(frames * sensors),
            label,
        };
        let mut front_ends = vec![XlFrontEnd::new(); sensors];
        for frame in 0..frames {
            for (sensor, front_end) in front_ends.iter_mut().enumerate() {
                let scan = episode.piezo(frame, sensor);
                front_end.push(episode.xl_batch(frame, sensor));
                features.piezo.extend(scan.counts());
                features.log_mel.extend(front_end.log_mel().standardised);
                features.touched.push(scan.sum() >= CONTACT_SUM_MIN);
            }
        }
        Ok(features)
    }

    /// Frames.
    pub fn frames(&self) -> usize {
        self.label.len()
    }

    /// Counts of one scan.
    pub fn scan(&self, frame: usize, sensor: usize) -> &[u16] {
        &self.piezo[(frame * self.sensors + sensor) * TAXELS..][..TAXELS]
    }

    /// Standardised log-mel of one sensor and frame.
    pub fn log_mel(&self, frame: usize, sensor: usize) -> &[i16] {
        &self.log_mel[(frame * self.sensors + sensor) * MEL_BINS..][..MEL_BINS]
    }

    /// The class when only these sensors are there: no contact if none of them is touched (D-8).
    pub fn label_for(&self, frame: usize, present: &[bool]) -> u8 {
        let touched = &self.touched[frame * self.sensors..][..self.sensors];
        let held = touched.iter().zip(present).any(|(&touched, &present)| touched && present);
        if held { self.label[frame] } else { 0 }
    }
}
