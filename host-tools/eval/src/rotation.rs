//! How the accelerometer is mounted must not matter: its axes are turned, and the detector's classes
//! compared with those of the axes as they are.
//!
//! Samples are turned in floating point, rounded to whole LSB again (half up) and cut off at the part's range,
//! so a turn adds rounding noise of its own. *Random* turns are uniform over all rotations, another for each
//! sensor, as fingers are mounted. *Permutations* of the axes and *sign flips* move samples without rounding;
//! they are reported apart, mirror images among them.

use std::fmt;

use anyhow::Result;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use slipsense::params::MAX_SENSORS;
use slipsense::sensor::XlSample;
use slipsense_recording::Episode;

use crate::detector::Detector;
use crate::metrics::statistics::{mean, share};
use crate::source::{Handle, Input};
use crate::table::{Table, percent};
use crate::targets::ROTATION_AGREE_SHARE;
use crate::truth::is_synthetic;

/// Name and version of the layout of the results.
pub(crate) const SCHEMA: &str = "slipsense-rotation/1";

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum TurnKind {
    /// Uniform over all rotations.
    Random,
    Permutation,
    SignFlip,
}

/// The axes of all sensors turned.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Turn {
    pub(crate) kind: TurnKind,
    /// `random 3`, `zxy`, `+x-y+z`.
    pub(crate) name: String,
    /// What maps each sensor's samples.
    pub(crate) per_sensor: [Matrix3<f64>; MAX_SENSORS],
}

/// A rotation, uniform over all (K. Shoemake, "Uniform random rotations", 1992).
fn uniform(rng: &mut ChaCha8Rng) -> Matrix3<f64> {
    let [u, v, w]: [f64; 3] = std::array::from_fn(|_| rng.random());
    let (a, b) = ((1.0 - u).sqrt(), u.sqrt());
    let ((sin_v, cos_v), (sin_w, cos_w)) =
        ((std::f64::consts::TAU * v).sin_cos(), (std::f64::consts::TAU * w).sin_cos());
    let quaternion = Quaternion::new(b * cos_w, a * sin_v, a * cos_v, b * sin_w);
    UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix().into_inner()
}

/// Permutations of the axes but the one that leaves them: which axis comes where.
const PERMUTATIONS: [&str; 5] = ["xzy", "yxz", "yzx", "zxy", "zyx"];

impl Turn {
    fn same_for_all(kind: TurnKind, name: String, matrix: Matrix3<f64>) -> Self {
        Self { kind, name, per_sensor: [matrix; MAX_SENSORS] }
    }

    /// `rotations` random turns from a seed, then all permutations and all sign flips.
    pub(crate) fn all(rotations: usize, seed: u64) -> Vec<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let random = |n: usize| Self {
            kind: TurnKind::Random,
            name: format!("random {n}"),
            per_sensor: std::array::from_fn(|_| uniform(&mut rng)),
        };
        let mut turns: Vec<Self> = (1..=rotations).map(random).collect();
        turns.extend(PERMUTATIONS.map(|name| {
            let matrix =
                Matrix3::from_fn(|row, col| f64::from(u8::from(name.as_bytes()[row] == b"xyz"[col])));
            Self::same_for_all(TurnKind::Permutation, name.to_owned(), matrix)
        }));
        turns.extend((1..8).map(|bits: u8| {
            let signs: [f64; 3] = std::array::from_fn(|axis| if bits >> axis & 1 == 1 { -1.0 } else { 1.0 });
            let name = ["x", "y", "z"].iter().zip(signs);
            let name = name.map(|(axis, sign)| format!("{}{axis}", if sign < 0.0 { "-" } else { "+" }));
            let matrix = Matrix3::from_diagonal(&Vector3::from(signs));
            Self::same_for_all(TurnKind::SignFlip, name.collect(), matrix)
        }));
        turns
    }

    /// One sample of a sensor turned, and whether an axis ran out of its range.
    pub(crate) fn sample(&self, sensor: usize, sample: XlSample) -> (XlSample, bool) {
        let turned = self.per_sensor[sensor] * Vector3::from(sample.map(f64::from));
        let whole: [f64; 3] = std::array::from_fn(|axis| (turned[axis] + 0.5).floor());
        let (least, most) = (f64::from(i16::MIN), f64::from(i16::MAX));
        let outside = whole.iter().any(|lsb| !(least..=most).contains(lsb));
        (whole.map(|lsb| lsb.clamp(least, most) as i16), outside)
    }
}

/// Counts of one turn; they add up.
#[derive(Clone, Copy, Debug, Default)]
struct Agreement {
    frames: usize,
    agree: usize,
    touched: usize,
    touched_agree: usize,
    samples: usize,
    outside: usize,
}

impl Agreement {
    fn add(&mut self, other: &Self) {
        self.frames += other.frames;
        self.agree += other.agree;
        self.touched += other.touched;
        self.touched_agree += other.touched_agree;
        self.samples += other.samples;
        self.outside += other.outside;
    }
}

/// How a detector's classes change with turned axes.
#[derive(Clone, Debug, Serialize)]
pub struct RotationResults {
    pub(crate) schema: &'static str,
    pub(crate) synthetic: bool,
    pub(crate) inputs: Vec<String>,
    pub(crate) episodes: usize,
    pub(crate) frames: usize,
    /// Frames with a touched pad: the others agree trivially.
    pub(crate) touched_frames: usize,
    pub(crate) seed: u64,
    /// Least share of the frames that must agree in every random turn.
    pub(crate) target_agree_share: f64,
    pub(crate) met: bool,
    pub(crate) kinds: Vec<KindResults>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct KindResults {
    pub(crate) kind: TurnKind,
    /// Lowest share of the frames with the same class; null without frames.
    pub(crate) agree_share_min: Option<f64>,
    pub(crate) agree_share_mean: Option<f64>,
    /// Lowest share of the frames with a touched pad; null where none is.
    pub(crate) touched_agree_share_min: Option<f64>,
    pub(crate) turns: Vec<TurnResults>,
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct TurnResults {
    pub(crate) name: String,
    /// Frames with the same class as unturned; null without frames.
    pub(crate) agree_share: Option<f64>,
    /// The same of the frames with a touched pad.
    pub(crate) touched_agree_share: Option<f64>,
    /// Samples cut off at the part's range.
    pub(crate) saturated_samples_share: Option<f64>,
}

/// Predict all episodes with every turn, each with a new detector, episodes in parallel; `done` is called after
/// each.
pub fn run<'a>(
    inputs: &[Input],
    make: &(dyn Fn() -> Result<Detector<'a>> + Sync),
    rotations: usize,
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> Result<RotationResults> {
    let turns = Turn::all(rotations, seed);
    let handles: Vec<&Handle> = inputs.iter().flat_map(|input| &input.episodes).collect();
    let compared = handles
        .par_iter()
        .map(|handle| {
            let episode = handle.load()?;
            let synthetic = is_synthetic(&episode.meta);
            let agreements = compare(episode, make, &turns)?;
            done();
            Ok((synthetic, agreements))
        })
        .collect::<Result<Vec<_>>>()?;
    let mut sums = vec![Agreement::default(); turns.len()];
    for (_, agreements) in &compared {
        sums.iter_mut().zip(agreements).for_each(|(sum, of)| sum.add(of));
    }
    let kinds: Vec<KindResults> = [TurnKind::Random, TurnKind::Permutation, TurnKind::SignFlip]
        .into_iter()
        .map(|kind| KindResults::new(kind, &turns, &sums))
        .filter(|kind| !kind.turns.is_empty())
        .collect();
    let least = kinds.iter().find(|kind| kind.kind == TurnKind::Random).and_then(|kind| kind.agree_share_min);
    Ok(RotationResults {
        schema: SCHEMA,
        synthetic: compared.iter().all(|(synthetic, _)| *synthetic),
        inputs: inputs.iter().map(|input| input.name.clone()).collect(),
        episodes: handles.len(),
        frames: sums.first().map_or(0, |sum| sum.frames),
        touched_frames: sums.first().map_or(0, |sum| sum.touched),
        seed,
        target_agree_share: ROTATION_AGREE_SHARE,
        met: least.is_some_and(|least| least >= ROTATION_AGREE_SHARE),
        kinds,
    })
}

fn compare<'a>(
    mut episode: Episode,
    make: &(dyn Fn() -> Result<Detector<'a>> + Sync),
    turns: &[Turn],
) -> Result<Vec<Agreement>> {
    let unturned = make()?(&episode)?;
    let samples = episode.xl.clone();
    let mut agreements = Vec::with_capacity(turns.len());
    for turn in turns {
        let mut agreement = Agreement::default();
        for (sensor, (turned, samples)) in episode.xl.iter_mut().zip(&samples).enumerate() {
            for (turned, &sample) in turned.iter_mut().zip(samples) {
                let outside;
                (*turned, outside) = turn.sample(sensor, sample);
                agreement.samples += 1;
                agreement.outside += usize::from(outside);
            }
        }
        let turned = make()?(&episode)?;
        for ((a, b), touched) in unturned.class.iter().zip(&turned.class).zip(&unturned.fallback) {
            let (agree, touched) = (usize::from(a == b), usize::from(*touched));
            agreement.frames += 1;
            agreement.agree += agree;
            agreement.touched += touched;
            agreement.touched_agree += agree * touched;
        }
        agreements.push(agreement);
    }
    Ok(agreements)
}

impl KindResults {
    fn new(kind: TurnKind, turns: &[Turn], sums: &[Agreement]) -> Self {
        let of_kind = turns.iter().zip(sums).filter(|(turn, _)| turn.kind == kind);
        let turns: Vec<TurnResults> = of_kind
            .map(|(turn, sum)| TurnResults {
                name: turn.name.clone(),
                agree_share: share(sum.agree, sum.frames),
                touched_agree_share: share(sum.touched_agree, sum.touched),
                saturated_samples_share: share(sum.outside, sum.samples),
            })
            .collect();
        let least = |of: fn(&TurnResults) -> Option<f64>| turns.iter().filter_map(of).min_by(f64::total_cmp);
        let agree: Vec<f64> = turns.iter().filter_map(|turn| turn.agree_share).collect();
        Self {
            kind,
            agree_share_min: least(|turn| turn.agree_share),
            agree_share_mean: mean(&agree),
            touched_agree_share_min: least(|turn| turn.touched_agree_share),
            turns,
        }
    }
}

impl fmt::Display for RotationResults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let title = format!(
            "same class with turned accelerometer axes, {} ({}): {} episodes, {} frames, {} of them touched",
            self.inputs.join(", "),
            if self.synthetic { "synthetic data" } else { "data" },
            self.episodes,
            self.frames,
            self.touched_frames
        );
        let table = Table::rows(title, 1, &self.kinds).columns(&[
            ("axes", |kind| {
                let words = match kind.kind {
                    TurnKind::Random => "random rotations",
                    TurnKind::Permutation => "axes exchanged",
                    TurnKind::SignFlip => "axes reversed",
                };
                words.to_owned()
            }),
            ("turns", |kind| kind.turns.len().to_string()),
            ("same % min", |kind| percent(kind.agree_share_min)),
            ("mean", |kind| percent(kind.agree_share_mean)),
            ("touched: min", |kind| percent(kind.touched_agree_share_min)),
            ("cut off % max", |kind| {
                let most = kind.turns.iter().filter_map(|turn| turn.saturated_samples_share);
                percent(most.max_by(f64::total_cmp))
            }),
        ]);
        let target = percent(Some(self.target_agree_share));
        let met = if self.met { "met" } else { "not met" };
        table.with_note(format!("target: at least {target} % in every random rotation: {met}")).fmt(f)
    }
}
