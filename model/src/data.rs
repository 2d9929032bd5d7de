//! Episodes to what the network sees, and which of them may be used for what.
//!
//! The split is by object as well as by episode: training never sees an object of the validation group,
//! nor a held-out one. Test splits do not occur here: `slipsense eval` runs them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use rayon::prelude::*;
use slipsense::features::{LN_FRAC_BITS, XlFrontEnd};
use slipsense::params::{CONTACT_SUM_MIN, MEL_BINS, TAXELS};
use slipsense_recording::Episode;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED};
use slipsense_synth::{Recipe, ScenarioChoice, Split, generate_set};

use crate::augment::level;
use crate::float::Sequences;
use crate::folder::{LabelledFolder, ObjectUses, Use};
use crate::pad_view::PadView;
use crate::piezo::IMAGE;
use crate::tract::log_mel_real;

/// Where episodes come from.
#[derive(Clone, Debug)]
pub enum Source {
    /// Made on the fly by the generator.
    Generated {
        /// Seed of the training episodes; those of validation are always the same.
        seed: u64,
    },
    /// All `.npz` files of a folder.
    Folder(LabelledFolder),
}

impl Source {
    /// A folder where one is named, else the generator.
    pub fn new(folder: Option<&Path>, seed: u64) -> Self {
        let of = |path: &Path| LabelledFolder { path: path.to_owned(), uses: ObjectUses::default() };
        folder.map_or(Self::Generated { seed }, |path| Self::Folder(of(path)))
    }

    /// The same with what a person says of a folder's objects; the generator's have their groups.
    pub fn with_uses(mut self, uses: ObjectUses) -> Self {
        if let Self::Folder(folder) = &mut self {
            folder.uses = uses;
        }
        self
    }

    /// Hand every episode for a use to `each`, on all cores; results in a fixed order. `count` is how
    /// many to generate, or the most to take from a folder.
    pub fn map<T: Send>(
        &self,
        what: Use,
        count: usize,
        bar: &ProgressBar,
        each: impl Fn(Episode) -> Result<T> + Sync,
    ) -> Result<Vec<T>> {
        match self {
            Self::Generated { seed } => {
                let recipes = recipes(what, *seed, count)?;
                bar.set_length(recipes.len() as u64);
                let results = generate_set(&recipes, |_, episode| {
                    let result = each(episode);
                    bar.inc(1);
                    result
                })?;
                results.into_iter().collect()
            }
            Self::Folder(folder) => {
                let mut files = folder.files(what)?;
                files.truncate(count);
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
            Self::Generated { seed } => format!("synthetic, split train, seed {seed}"),
            Self::Folder(folder) => format!("episodes in {}", folder.path.display()),
        }
    }
}

/// One training episode in this many holds disturbances only: the protocol's have few, and a network that
/// was not trained on them raises alarms.
const DISTURBANCES_EVERY: usize = 8;
/// Their length, seconds: room for a few grasps.
const DISTURBANCES_SECONDS: f64 = 20.0;

/// Recipes of the first generated episodes of the split for this use.
pub fn recipes(what: Use, seed: u64, count: usize) -> Result<Vec<Recipe>> {
    let set = match what {
        Use::Train => EpisodeSet::first(Split::Train, seed, count),
        Use::Validation => EpisodeSet::first(Split::Val, FROZEN_SEED, count),
        Use::Test => bail!("test splits are for `slipsense eval`"),
    };
    let recipes = set.episodes.into_iter().map(|episode| episode.recipe).enumerate();
    let disturbed = |index: usize| what == Use::Train && index % DISTURBANCES_EVERY == DISTURBANCES_EVERY - 1;
    Ok(recipes.map(|(index, recipe)| if disturbed(index) { disturbances(recipe) } else { recipe }).collect())
}

/// The same hand and object, disturbed all the time and never slipping.
fn disturbances(recipe: Recipe) -> Recipe {
    Recipe {
        scenario: ScenarioChoice::Disturbances,
        seconds: Some(DISTURBANCES_SECONDS),
        speed_mm_s: None,
        ..recipe
    }
}

/// One episode as the network sees it.
#[derive(Clone, Debug)]
pub struct Features {
    /// Sensors.
    pub sensors: usize,
    /// Counts, `[frame][sensor]`.
    pub piezo: Vec<[u16; TAXELS]>,
    /// Natural log of the mel power before standardisation, LSB², `[frame][sensor]`.
    pub ln_power: Vec<[f32; MEL_BINS]>,
    /// Standardised log-mel, Q2.13, `[frame][sensor]`.
    pub log_mel: Vec<[i16; MEL_BINS]>,
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
            piezo: Vec::with_capacity(frames * sensors),
            ln_power: Vec::with_capacity(frames * sensors),
            log_mel: Vec::with_capacity(frames * sensors),
            touched: Vec::with_capacity(frames * sensors),
            label,
        };
        let mut front_ends = vec![XlFrontEnd::new(); sensors];
        for frame in 0..frames {
            for (sensor, front_end) in front_ends.iter_mut().enumerate() {
                let scan = episode.piezo(frame, sensor);
                front_end.push(episode.xl_batch(frame, sensor));
                let log_mel = front_end.log_mel();
                features.piezo.push(*scan.counts());
                features.ln_power.push(log_mel.ln_power.map(|q16| q16 as f32 / (1 << LN_FRAC_BITS) as f32));
                features.log_mel.push(log_mel.standardised);
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
    pub fn scan(&self, frame: usize, sensor: usize) -> &[u16; TAXELS] {
        &self.piezo[frame * self.sensors + sensor]
    }

    /// Log of the mel power of one sensor and frame.
    pub fn ln_power(&self, frame: usize, sensor: usize) -> &[f32; MEL_BINS] {
        &self.ln_power[frame * self.sensors + sensor]
    }

    /// Standardised log-mel of one sensor and frame.
    pub fn log_mel(&self, frame: usize, sensor: usize) -> &[i16; MEL_BINS] {
        &self.log_mel[frame * self.sensors + sensor]
    }

    /// The whole episode as it is, for the network in float.
    pub fn sequences(&self) -> Sequences {
        self.sequences_of(PadView::default())
    }

    /// The whole episode with so much of the pads.
    pub fn sequences_of(&self, pads: PadView) -> Sequences {
        let frames = self.frames();
        let mut all = Sequences {
            batch: 1,
            sensors: self.sensors,
            frames,
            piezo: Vec::with_capacity(frames * self.sensors * IMAGE),
            log_mel: Vec::with_capacity(frames * self.sensors * MEL_BINS),
            level: Vec::with_capacity(frames * self.sensors),
            label: self.label.clone(),
            weight: vec![1.0; frames],
            taught: Vec::new(),
        };
        for sensor in 0..self.sensors {
            let mut view = pads.start();
            for frame in 0..frames {
                view.push(self.scan(frame, sensor), |_, cell| all.piezo.extend(cell));
                all.log_mel.extend(self.log_mel(frame, sensor).map(log_mel_real));
                all.level.push(level(self.ln_power(frame, sensor)));
            }
        }
        all
    }

    /// The class when only these sensors are there: no contact if none of them is touched.
    pub fn label_for(&self, frame: usize, present: &[bool]) -> u8 {
        let touched = &self.touched[frame * self.sensors..][..self.sensors];
        let held = touched.iter().zip(present).any(|(&touched, &present)| touched && present);
        if held { self.label[frame] } else { 0 }
    }
}
