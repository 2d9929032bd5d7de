//! How the accelerometer happens to be mounted must not matter: its axes are turned, and the detector's classes
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

use crate::detectors::Detector;
use crate::grid::Grid;
use crate::metrics::statistics::share;
use crate::source::{Handle, Input};
use crate::table::percent;
use crate::targets::ROTATION_AGREE_SHARE;
use crate::truth::is_synthetic;

/// Name and version of the layout of the results.
pub const SCHEMA: &str = "slipsense-rotation/1";

/// What sort of turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TurnKind {
    /// Uniform over all rotations.
    Random,
    /// Axes exchanged.
    Permutation,
    /// Axes reversed.
    SignFlip,
}

/// The axes of all sensors turned.
#[derive(Clone, Debug, PartialEq)]
pub struct Turn {
    /// What sort.
    pub kind: TurnKind,
    /// `random 3`, `zxy`, `+x-y+z`.
    pub name: String,
    /// What maps each sensor's samples.
    pub of_sensor: [Matrix3<f64>; MAX_SENSORS],
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
const PERMUTATIONS: [(&str, [usize; 3]); 5] =
    [("xzy", [0, 2, 1]), ("yxz", [1, 0, 2]), ("yzx", [1, 2, 0]), ("zxy", [2, 0, 1]), ("zyx", [2, 1, 0])];

impl Turn {
    fn of_all(kind: TurnKind, name: String, matrix: Matrix3<f64>) -> Self {
        Self { kind, name, of_sensor: [matrix; MAX_SENSORS] }
    }

    /// `rotations` random turns from a seed, then all permutations and all sign flips.
    pub fn all(rotations: usize, seed: u64) -> Vec<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let random = |n: usize| Self {
            kind: TurnKind::Random,
            name: format!("random {n}"),
            of_sensor: std::array::from_fn(|_| uniform(&mut rng)),
        };
        let mut turns: Vec<Self> = (1..=rotations).map(random).collect();
        turns.extend(PERMUTATIONS.map(|(name, from)| {
            let matrix = Matrix3::from_fn(|row, col| f64::from(u8::from(from[row] == col)));
            Self::of_all(TurnKind::Permutation, name.to_owned(), matrix)
        }));
        turns.extend((1..8).map(|bits: u8| {
            let signs: [f64; 3] = std::array::from_fn(|axis| if bits >> axis & 1 == 1 { -1.0 } else { 1.0 });
            let name = ["x", "y", "z"].iter().zip(signs);
            let name = name.map(|(axis, sign)| format!("{}{axis}", if sign < 0.0 { "-" } else { "+" }));
            let matrix = Matrix3::from_diagonal(&Vector3::from(signs));
            Self::of_all(TurnKind::SignFlip, name.collect(), matrix)
        }));
        turns
    }

    /// One sample of a sensor turned, and whether an axis ran out of its range.
    pub fn sample(&self, sensor: usize, sample: XlSample) -> (XlSample, bool) {
        let turned = self.of_sensor[sensor] * Vector3::from(sample.map(f64::from));
        let whole: [f64; 3] = std::array::from_fn(|axis| (turned[axis] + 0.5).floor());
        let (least, most) = (f64::from(i16::MIN), f64::from(i16::MAX));
        let outside = whole.iter().any(|lsb| !(least..=most).contains(lsb));
        (whole.map(|lsb| lsb.clamp(least, most) as i16), outside)
    }
}

/// Counts of one turn; they add up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
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

/// How a detector takes turned axes.
#[derive(Clone, Debug, Serialize)]
pub struct RotationResults {
    /// [`SCHEMA`].
    pub schema: &'static str,
    /// Every episode was made by a generator.
    pub synthetic: bool,
    /// Names of the inputs.
    pub inputs: Vec<String>,
    /// Episodes of all inputs.
    pub episodes: usize,
    /// Frames of all inputs.
    pub frames: usize,
    /// ... of which a pad is touched: the others agree without any effort.
    pub touched_frames: usize,
    /// Seed of the random turns.
    pub seed: u64,
    /// Least share of the frames that must agree in every random turn.
    pub target_agree_share: f64,
    /// Whether every random turn reaches it.
    pub met: bool,
    /// Kind by kind.
    pub kinds: Vec<KindResults>,
}

/// The turns of one kind.
#[derive(Clone, Debug, Serialize)]
pub struct KindResults {
    /// Kind.
    pub kind: TurnKind,
    /// Lowest share of the frames with the same class; null without frames.
    pub agree_share_min: Option<f64>,
    /// Mean share.
    pub agree_share_mean: Option<f64>,
    /// Lowest share of the frames with a touched pad; null where none is.
    pub touched_agree_share_min: Option<f64>,
    /// Turn by turn.
    pub turns: Vec<TurnResults>,
}

/// One turn.
#[derive(Clone, Debug, Serialize)]
pub struct TurnResults {
    /// Name.
    pub name: String,
    /// Frames with the same class as unturned; null without frames.
    pub agree_share: Option<f64>,
    /// The same of the frames with a touched pad.
    pub touched_agree_share: Option<f64>,
    /// Samples cut off at the part's range.
    pub saturated_samples_share: Option<f64>,
}

/// Judge all episodes with every turn. Episodes go in parallel, each from a fresh state of the detector;
/// `done` is called after each.
pub fn run<'a>(
    inputs: &[Input],
    make: &(dyn Fn() -> Result<Box<dyn Detector + 'a>> + Sync),
    rotations: usize,
    seed: u64,
    done: &(dyn Fn() + Sync),
) -> Result<RotationResults> {
    let turns = Turn::all(rotations, seed);
    let handles: Vec<&Handle> = inputs.iter().flat_map(|input| &input.episodes).collect();
    let judged = handles
        .par_iter()
        .map(|handle| {
            let episode = handle.load()?;
            let synthetic = is_synthetic(&episode.meta);
            let agreements = judge(episode, make()?.as_mut(), &turns)?;
            done();
            Ok((synthetic, agreements))
        })
        .collect::<Result<Vec<_>>>()?;
    let mut sums = vec![Agreement::default(); turns.len()];
    for (_, agreements) in &judged {
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
        synthetic: judged.iter().all(|(synthetic, _)| *synthetic),
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

fn judge(mut episode: Episode, detector: &mut dyn Detector, turns: &[Turn]) -> Result<Vec<Agreement>> {
    let straight = detector.judge(&episode)?;
    let samples = episode.xl.clone();
    let mut agreements = Vec::with_capacity(turns.len());
    for turn in turns {
        let mut agreement = Agreement::default();
        for (sensor, (turned, straight)) in episode.xl.iter_mut().zip(&samples).enumerate() {
            for (turned, &straight) in turned.iter_mut().zip(straight) {
                let outside;
                (*turned, outside) = turn.sample(sensor, straight);
                agreement.samples += 1;
                agreement.outside += usize::from(outside);
            }
        }
        detector.reset();
        let verdict = detector.judge(&episode)?;
        for ((a, b), touched) in straight.class.iter().zip(&verdict.class).zip(&straight.fallback) {
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
            agree_share_mean: crate::metrics::statistics::mean(&agree),
            touched_agree_share_min: least(|turn| turn.touched_agree_share),
            turns,
        }
    }
}

impl RotationResults {
    fn grid(&self) -> Grid {
        let word = |kind: TurnKind| match kind {
            TurnKind::Random => "random rotations",
            TurnKind::Permutation => "axes exchanged",
            TurnKind::SignFlip => "axes reversed",
        };
        let cut_off = |kind: &KindResults| {
            let most = kind.turns.iter().filter_map(|turn| turn.saturated_samples_share);
            percent(most.max_by(f64::total_cmp))
        };
        let cells = |kind: &KindResults| {
            vec![
                word(kind.kind).to_owned(),
                kind.turns.len().to_string(),
                percent(kind.agree_share_min),
                percent(kind.agree_share_mean),
                percent(kind.touched_agree_share_min),
                cut_off(kind),
            ]
        };
        let data = if self.synthetic { "synthetic data" } else { "data" };
        Grid {
            title: format!(
                "same class with turned accelerometer axes, {} ({data}): {} episodes, {} frames, {} of them touched",
                self.inputs.join(", "),
                self.episodes,
                self.frames,
                self.touched_frames
            ),
            header: vec!["axes", "turns", "same % min", "mean", "touched: min", "cut off % max"],
            word_columns: 1,
            rows: self.kinds.iter().map(cells).collect(),
            note: format!(
                "target: at least {} % in every random rotation: {}",
                percent(Some(self.target_agree_share)),
                if self.met { "met" } else { "not met" }
            ),
        }
    }
}

impl fmt::Display for RotationResults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.grid().fmt(f)
    }
}
