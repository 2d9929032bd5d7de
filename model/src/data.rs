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
use slipsense_recording::Episode;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED};
use slipsense_synth::{Recipe, ScenarioChoice, Split, generate_set, vary_two_of_three};

use crate::float::Sequences;
use crate::folder::{LabelledFolder, ObjectUses, Use};
use crate::pad_view::PadView;
use crate::piezo::IMAGE;
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
/// Length of an episode of disturbances, seconds: room for a few grasps.
pub(crate) const DISTURBANCES_SECONDS: f64 = 20.0;

/// Recipes of the first generated episodes for this use.
pub fn recipes(what: Use, seed: u64, count: usize) -> Result<Vec<Recipe>> {
    let first = |split: Split, seed: u64| {
        let set = EpisodeSet::first(split, seed, count);
        set.episodes.into_iter().map(|episode| episode.recipe)
    };
    match what {
        Use::Train => {
            let (mut train, mut anywhere) = (first(Split::Train, seed), first(Split::TrainAnywhere, seed));
            let turns = TURNS.iter().cycle().take(count);
            let recipe = |&(split, disturbed): &(Split, bool)| {
                let recipes = if split == Split::Train { &mut train } else { &mut anywhere };
                recipes.next().map(|recipe| if disturbed { disturbances(recipe) } else { recipe })
            };
            Ok(vary_two_of_three(turns.filter_map(recipe))?)
        }
        Use::Validation => {
            let pairs = first(Split::Val, FROZEN_SEED).zip(first(Split::ValAnywhere, FROZEN_SEED));
            let three = |(laboratory, anywhere): (Recipe, Recipe)| {
                [laboratory, anywhere.clone(), disturbances(anywhere)]
            };
            Ok(pairs.flat_map(three).take(count).collect())
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

/// One episode as the network sees it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Features {
    pub sensors: usize,
    /// Counts of the touched pads, in the order of frames and sensors.
    piezo: Vec<[u16; TAXELS]>,
    /// Place of each scan in `piezo`, `[frame][sensor]`; none of an untouched pad, which the network sees as zeros.
    scan: Vec<Option<u32>>,
    /// Natural log of the mel power before standardisation, LSB², `[frame][sensor]`.
    pub ln_power: Vec<[f32; MEL_BINS]>,
    /// The noise floors it is compared with, ln of LSB², `[frame][sensor]`.
    pub floor: Vec<[f32; MEL_BINS]>,
    /// What the network sees of the accelerometers, `[frame][sensor]`.
    pub xl: Vec<XlFeatures>,
    /// Is the pad touched, `[frame][sensor]`.
    pub touched: Vec<bool>,
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
                features.ln_power.push(log_mel.ln_power.map(real));
                features.floor.push(floor.map(real));
                features.xl.push(log_mel.features());
                let touched = scan.sum() >= CONTACT_SUM_MIN;
                features.touched.push(touched);
                features.scan.push(touched.then_some(features.piezo.len() as u32));
                if touched {
                    features.piezo.push(*scan.counts());
                }
            }
        }
        Ok(features)
    }

    /// Of all episodes that a generator makes of these recipes; `bar` moves once an episode.
    pub(crate) fn of_recipes(recipes: &[Recipe], bar: &ProgressBar) -> Result<Vec<Self>> {
        let features = generate_set(recipes, |_, episode| {
            bar.inc(1);
            Self::from_episode(&episode)
        })?;
        bar.finish_and_clear();
        features.into_iter().collect()
    }

    /// Some of the frames.
    pub fn cut(&self, frames: std::ops::Range<usize>) -> Self {
        let rows = frames.start * self.sensors..frames.end * self.sensors;
        let mut piezo = Vec::new();
        let mut kept = |place: &Option<u32>| {
            place.map(|place| {
                piezo.push(self.piezo[place as usize]);
                piezo.len() as u32 - 1
            })
        };
        let scan = self.scan[rows.clone()].iter().map(&mut kept).collect();
        Self {
            sensors: self.sensors,
            scan,
            piezo,
            ln_power: self.ln_power[rows.clone()].to_vec(),
            floor: self.floor[rows.clone()].to_vec(),
            xl: self.xl[rows.clone()].to_vec(),
            touched: self.touched[rows].to_vec(),
            label: self.label[frames.clone()].to_vec(),
            target: self.target[frames].to_vec(),
            mined: self.mined,
        }
    }

    /// The same, kept as hard.
    pub(crate) fn into_mined(self) -> Self {
        Self { mined: true, ..self }
    }

    pub fn frames(&self) -> usize {
        self.label.len()
    }

    /// Is any pad touched, of every frame.
    pub(crate) fn contacts(&self) -> impl Iterator<Item = bool> {
        self.touched.chunks_exact(self.sensors).map(|pads| pads.contains(&true))
    }

    /// Counts of one scan; zeros of an untouched pad.
    pub fn scan(&self, frame: usize, sensor: usize) -> &[u16; TAXELS] {
        self.scan[frame * self.sensors + sensor].map_or(&[0; TAXELS], |place| &self.piezo[place as usize])
    }

    pub fn ln_power(&self, frame: usize, sensor: usize) -> &[f32; MEL_BINS] {
        &self.ln_power[frame * self.sensors + sensor]
    }

    pub fn floor(&self, frame: usize, sensor: usize) -> &[f32; MEL_BINS] {
        &self.floor[frame * self.sensors + sensor]
    }

    /// What the network sees of one accelerometer at one frame.
    pub fn xl(&self, frame: usize, sensor: usize) -> &XlFeatures {
        &self.xl[frame * self.sensors + sensor]
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
                view.push(self.scan(frame, sensor), |_, cell| all.piezo.extend(cell));
                all.xl.extend(self.xl(frame, sensor).map(xl_real));
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

    /// What the detector is to say when only these sensors are there: nothing slides if none of them is touched.
    pub fn target_for(&self, frame: usize, present: &[bool]) -> Target {
        match self.label_for(frame, present) {
            0 if self.label[frame] != 0 => Target::Either,
            _ => self.target[frame],
        }
    }
}
