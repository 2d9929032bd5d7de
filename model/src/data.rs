//! Episodes to what the network sees, and which of them may be used for what.
//!
//! The split is by object as well as by episode: training never sees an object of the validation group,
//! nor a held-out one. Test splits do not occur here: `slipsense eval` runs them.

pub mod stretches_file;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use indicatif::ProgressBar;
use rayon::prelude::*;
use slipsense::features::{LN_FRAC_BITS, XlFeatures, XlFrontEnd};
use slipsense::params::{CONTACT_SUM_MIN, MEL_BINS, TAXELS, XL_FEATURES};
use slipsense::sensor::PiezoFrame;
use slipsense_recording::Episode;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED};
use slipsense_synth::{Recipe, ScenarioChoice, Split, generate_set, vary_two_of_three};

use crate::float::Sequences;
use crate::folder::{Chosen, LabelledFolder, ObjectUses, Use};
use crate::pad_view::PadView;
use crate::piezo::IMAGE;
use crate::progress::progress;
use crate::target::{Target, targets};
use crate::tract::xl_real;

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
    /// A folder where one is named, with what a person says of its objects; else the generator.
    pub fn new(folder: Option<&Path>, uses: ObjectUses, seed: u64) -> Self {
        match folder {
            Some(path) => Self::Folder(LabelledFolder { path: path.to_owned(), uses }),
            None => Self::Generated { seed },
        }
    }

    /// What `each` makes of every episode for a use, in order, on all cores. `count`: how many to generate, or the most
    /// to take from a folder; what is left out there is said.
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
                let Chosen { files, left_out, .. } = folder.choose(what, count)?;
                if let Some(left_out) = left_out {
                    bar.suspend(|| eprintln!("{left_out}"));
                }
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
            Self::Generated { seed } => format!(
                "synthetic, splits train and train_anywhere, two of three objects varied, seed {seed}"
            ),
            Self::Folder(folder) => format!("episodes in {}", folder.path.display()),
        }
    }
}

/// What training episodes are, in turn: of the laboratory's physics or of other families, and whether they hold
/// disturbances only. The protocol has few, and a network that was not trained on them raises alarms.
const TURNS: [(Split, bool); 8] = [
    (Split::TrainAnywhere, false),
    (Split::Train, false),
    (Split::TrainAnywhere, true),
    (Split::TrainAnywhere, false),
    (Split::Train, false),
    (Split::TrainAnywhere, false),
    (Split::Train, true),
    (Split::Train, true),
];
/// Is a generated training episode, by its place, of the laboratory's physics.
pub(crate) fn is_of_laboratory(place: usize) -> bool {
    TURNS[place % TURNS.len()].0 == Split::Train
}

/// Length of an episode of disturbances, seconds: room for a few grasps.
pub(crate) const DISTURBANCES_SECONDS: f64 = 20.0;

/// Recipes of a split's first episodes.
pub(crate) fn first(split: Split, seed: u64, count: usize) -> impl Iterator<Item = Recipe> {
    EpisodeSet::first(split, seed, count).episodes.into_iter().map(|episode| episode.recipe)
}

/// Recipes of the first generated episodes for this use.
pub fn recipes(what: Use, seed: u64, count: usize) -> Result<Vec<Recipe>> {
    match what {
        Use::Train => {
            let [mut train, mut anywhere] =
                [Split::Train, Split::TrainAnywhere].map(|split| first(split, seed, count));
            let turns = TURNS.iter().cycle().take(count);
            let recipe = |&(split, disturbed): &(Split, bool)| {
                let recipes = if split == Split::Train { &mut train } else { &mut anywhere };
                recipes.next().map(|recipe| if disturbed { disturbances(recipe) } else { recipe })
            };
            Ok(vary_two_of_three(turns.filter_map(recipe))?)
        }
        Use::Validation => {
            let [laboratory, anywhere] =
                [Split::Val, Split::ValAnywhere].map(|split| first(split, FROZEN_SEED, count));
            let three = |(laboratory, anywhere): (Recipe, Recipe)| {
                [laboratory, anywhere.clone(), disturbances(anywhere)]
            };
            Ok(laboratory.zip(anywhere).flat_map(three).take(count).collect())
        }
        Use::Test => bail!("test splits are for `slipsense eval`"),
    }
}

/// The same hand and object, disturbed all the time and never slipping.
pub(crate) fn disturbances(recipe: Recipe) -> Recipe {
    Recipe {
        scenario: ScenarioChoice::Disturbances,
        seconds: Some(DISTURBANCES_SECONDS),
        pull_angle_deg: None,
        speed_mm_s: None,
        ..recipe
    }
}

/// What the front end makes of one sensor in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading {
    /// Counts of a touched pad; none of an untouched one, which the network sees as zeros.
    scan: Option<Box<[u16; TAXELS]>>,
    /// Natural log of the mel power before standardisation, LSB².
    pub ln_power: [f32; MEL_BINS],
    /// The noise floors it is compared with, ln of LSB².
    pub floor: [f32; MEL_BINS],
    /// What the network sees of the accelerometer.
    pub xl: XlFeatures,
}

impl Reading {
    /// Counts; zeros of an untouched pad.
    pub fn scan(&self) -> &[u16; TAXELS] {
        self.scan.as_deref().unwrap_or(&[0; TAXELS])
    }
}

/// One episode as the network sees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    pub sensors: usize,
    /// `[frame][sensor]`.
    pub readings: Vec<Reading>,
    /// Classes, `[frame]`.
    pub label: Vec<u8>,
    /// What the detector is to say, `[frame]`.
    pub target: Vec<Target>,
    /// Kept because a trained network took it for slip: see [`crate::mining`].
    pub mined: bool,
}

impl Features {
    /// Run the microcontroller's own front end over an episode.
    pub fn from_episode(episode: &Episode) -> Result<Self> {
        let label = episode.label.clone().context("array label is missing, needed for training")?;
        let (frames, sensors) = (episode.frames(), episode.sensors);
        let target = targets(episode, &label);
        let mut features = Self { sensors, target, label, ..Self::default() };
        let mut front_ends = vec![XlFrontEnd::new(); sensors];
        for frame in 0..frames {
            for (sensor, front_end) in front_ends.iter_mut().enumerate() {
                let scan = episode.piezo(frame, sensor);
                front_end.push(episode.xl_batch(frame, sensor));
                let floor = *front_end.noise_floor().floor();
                let log_mel = front_end.log_mel();
                let real = |q16: i32| q16 as f32 / (1 << LN_FRAC_BITS) as f32;
                features.readings.push(Reading {
                    scan: (scan.sum() >= CONTACT_SUM_MIN).then(|| Box::new(*scan.counts())),
                    ln_power: log_mel.ln_power.map(real),
                    floor: floor.map(real),
                    xl: log_mel.features(),
                });
            }
        }
        Ok(features)
    }

    /// Of all episodes that a generator makes of these recipes, with a progress bar of this name.
    pub(crate) fn of_recipes(name: &'static str, recipes: &[Recipe]) -> Result<Vec<Self>> {
        let bar = progress(name, recipes.len() as u64);
        let features = generate_set(recipes, |_, episode| {
            bar.inc(1);
            Self::from_episode(&episode)
        })?;
        bar.finish_and_clear();
        features.into_iter().collect()
    }

    pub fn cut(&self, frames: std::ops::Range<usize>) -> Self {
        Self {
            sensors: self.sensors,
            readings: self.readings[frames.start * self.sensors..frames.end * self.sensors].to_vec(),
            label: self.label[frames.clone()].to_vec(),
            target: self.target[frames].to_vec(),
            mined: self.mined,
        }
    }

    pub fn frames(&self) -> usize {
        self.label.len()
    }

    /// Is any pad touched, of every frame.
    pub(crate) fn contacts(&self) -> impl Iterator<Item = bool> {
        self.readings.chunks_exact(self.sensors).map(|frame| frame.iter().any(|one| one.scan.is_some()))
    }

    pub fn reading(&self, frame: usize, sensor: usize) -> &Reading {
        &self.readings[frame * self.sensors + sensor]
    }

    /// The scans of a frame; zeros of untouched pads.
    pub(crate) fn scans(&self, frame: usize) -> Vec<PiezoFrame> {
        let scan = |one: &Reading| PiezoFrame::from_counts(*one.scan()).expect("counts of a scan");
        self.readings[frame * self.sensors..][..self.sensors].iter().map(scan).collect()
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
            xl: Vec::with_capacity(frames * self.sensors * XL_FEATURES),
            label: self.label.clone(),
            weight: vec![1.0; frames],
            target: self.target.clone(),
            ..Sequences::default()
        };
        for sensor in 0..self.sensors {
            let mut view = pads.start();
            for frame in 0..frames {
                let reading = self.reading(frame, sensor);
                view.push(reading.scan(), |_, cell| all.piezo.extend(cell));
                all.xl.extend(reading.xl.map(xl_real));
            }
        }
        all
    }

    /// The class when only these sensors are there: no contact if none of them is touched.
    pub fn label_for(&self, frame: usize, present: &[bool]) -> u8 {
        let readings = &self.readings[frame * self.sensors..][..self.sensors];
        let held = readings.iter().zip(present).any(|(one, &present)| present && one.scan.is_some());
        if held { self.label[frame] } else { 0 }
    }

    /// What the detector is to say when only these sensors are there: nothing slides if none of them is touched.
    pub fn target_for(&self, frame: usize, present: &[bool]) -> Target {
        match self.label_for(frame, present) {
            0 if self.label[frame] != 0 => Target::Either,
            _ => self.target[frame],
        }
    }
}
