//! The trainer.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, ensure};
use burn::grad_clipping::GradientClippingConfig;
use burn::optim::{AdamWConfig, ModuleOptimizer};
use burn::tensor::Device;
use clap::Args;
use serde_json::json;
use slipsense::net::format::Dims;
use slipsense::params::{CLASSES, OUTPUTS};
use slipsense_synth::objects::{self, Group};

use crate::batch::{Options, Sampler};
use crate::checkpoint::{Checkpoint, Row, csv};
use crate::data::{Features, Source};
use crate::device::DeviceName;
use crate::evaluate::{DetectorFigures, Scores, VALIDATION_ALARMS_PER_HOUR, detector_figures, score_logits};
use crate::float::FloatNetwork;
use crate::folder::{ObjectUses, Use};
use crate::mining::{self, mine};
use crate::progress::progress;
use crate::real_parts::RealParts;
use crate::teacher::Teacher;
use crate::weights::{Weights, dims_of_size};
use crate::{curves, output};

/// Share of all steps over which the learning rate rises.
const WARM_UP: f64 = 0.05;
/// Decay of the weights' running average. The paper names none and 0.999 is customary; a run of some
/// thousand steps would then still carry its first weights at the end, and the last steps are small.
const AVERAGE_DECAY: f64 = 0.998;
/// Largest norm of one tensor's gradient.
const GRADIENT_NORM: f32 = 1.0;
const WEIGHT_DECAY: f32 = 1e-3;

/// What a training leaves: its weights, and what they were trained on and how.
pub(crate) const WEIGHTS: &str = "weights.safetensors";
pub(crate) const RECORD: &str = "train.json";

/// Train the float network on generated or recorded episodes.
///
/// Writes DIR/weights.safetensors (the running average of the weights), curves.csv (one line per epoch),
/// curves.svg (the same as a picture) and train.json (what it was trained on, and how). After every epoch DIR/checkpoint holds what
/// --resume needs. Quantize the result with `slipsense quantize`.
#[derive(Args, Clone, Debug)]
pub struct TrainArgs {
    /// Folder for the results; made if it is not there.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Train on the labelled .npz episodes of this folder instead of generated ones. They are split into
    /// train, validation and test by the "object" in their metadata: by a hash of its name, or as
    /// --validation and --test say. `slipsense label` makes such episodes.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// With --data: an object to validate on; may be given several times. The objects that neither this
    /// nor --test names are then trained on.
    #[arg(long, value_name = "OBJECT", requires = "data")]
    pub validation: Vec<String>,
    /// With --data: an object to leave alone, for a later `slipsense eval`; may be given several times.
    #[arg(long, value_name = "OBJECT", requires = "data")]
    pub test: Vec<String>,
    /// Number of training episodes to generate, or the most to read
    #[arg(long, value_name = "N", default_value_t = 640)]
    pub episodes: usize,
    /// Passes over as many frames as the training episodes have.
    #[arg(long, value_name = "N", default_value_t = 10)]
    pub epochs: usize,
    /// Seed of the episodes, the first weights and all draws.
    #[arg(long, value_name = "K", default_value_t = 1)]
    pub seed: u64,
    /// Sequences per step.
    #[arg(long, value_name = "N", default_value_t = 12)]
    pub batch: usize,
    /// Frames per sequence. The network looks back 60 frames.
    #[arg(long, value_name = "N", default_value_t = 240)]
    pub frames: usize,
    /// Highest learning rate; it rises over the first steps and falls along a half cosine.
    #[arg(long, value_name = "LR", default_value_t = 3e-3)]
    pub learning_rate: f64,
    /// Channels, filters and embeddings, times those of the shipped network (not the filters of the third convolution);
    /// twice the size does not fit the microcontroller, and can teach.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=2))]
    pub size: u8,
    /// Float weights to begin with, such as the shipped model's, instead of random ones; a lower
    /// --learning-rate then forgets less.
    #[arg(long, value_name = "FILE")]
    pub start: Option<PathBuf>,
    /// Float weights of a trained network, such as a larger one; may be given several times. All are asked
    /// about every batch, and the mean of what they say counts as much as the labels.
    #[arg(long, value_name = "FILE")]
    pub teacher: Vec<PathBuf>,
    /// Hours of disturbances of which --start's network picks what it takes for slip, to train on beside the episodes
    #[arg(long, value_name = "H", default_value_t = 0.0, requires = "start")]
    pub mine_hours: f64,
    /// Folder of stretches that `slipsense mine` found, to train on beside the episodes
    #[arg(long, value_name = "DIR")]
    pub mined: Option<PathBuf>,
    /// What the surest frame of a slip's onset and the worst of 200 ms without slip count beside all others
    #[arg(long, value_name = "W", default_value_t = 2.0)]
    pub extreme_weight: f32,
    /// Folder with motion.npz and surfaces.npz, recorded motion and measured surfaces that some of the
    /// generated episodes get; docs/src/model/training.md says from which public sources they are made
    #[arg(long, value_name = "DIR", conflicts_with = "data")]
    pub real_parts: Option<PathBuf>,
    /// What trains; the same recipe on another device ends with other roundings
    #[arg(long, value_enum, value_name = "NAME", default_value_t)]
    pub device: DeviceName,
    /// Go on after the last finished epoch of the same run in DIR.
    #[arg(long)]
    pub resume: bool,
}

impl TrainArgs {
    fn dims(&self) -> Dims {
        dims_of_size(self.size.into())
    }

    fn object_uses(&self) -> ObjectUses {
        ObjectUses { validation: self.validation.clone(), test: self.test.clone() }
    }
}

/// The optimizer before its first step.
pub(crate) fn optimizer() -> ModuleOptimizer {
    AdamWConfig::new()
        .with_weight_decay(WEIGHT_DECAY)
        .with_epsilon(1e-8)
        .with_grad_clipping(Some(GradientClippingConfig::Norm(GRADIENT_NORM)))
        .init()
}

/// Share of the highest learning rate at a step: linear rise, then half a cosine to 0.
pub(crate) fn schedule(step: usize, steps: usize) -> f64 {
    let total = steps as f64;
    let warm = (total * WARM_UP).max(1.0);
    let done = step as f64 + 1.0;
    let share = ((done - warm) / (total - warm).max(1.0)).clamp(0.0, 1.0);
    (done / warm).min(1.0) * 0.5 * (1.0 + (std::f64::consts::PI * share).cos())
}

/// Decay of the weights' running average at a step: less at first, so that the first weights are forgotten.
pub(crate) fn average_decay(step: usize) -> f32 {
    AVERAGE_DECAY.min((1.0 + step as f64) / (10.0 + step as f64)) as f32
}

pub fn run_train(args: &TrainArgs) -> Result<()> {
    ensure!(args.episodes > 0, "--episodes must be at least 1");
    ensure!(args.epochs > 0, "--epochs must be at least 1");
    ensure!(args.batch > 0, "--batch must be at least 1");
    ensure!(args.frames > 0, "--frames must be at least 1");
    ensure!(
        args.learning_rate > 0.0 && args.learning_rate <= 1.0,
        "--learning-rate must be above 0 and at most 1"
    );
    let device = args.device.open()?.autodiff();
    let teachers = args.teacher.iter().map(|path| Weights::read(path)).collect::<Result<Vec<_>>>()?;
    let first = first_weights(args)?;
    let source = Source::new(args.data.as_deref(), args.object_uses(), args.seed);
    if let Source::Folder(folder) = &source {
        println!("{}", folder.describe()?);
    }
    let real_parts = args.real_parts.as_deref().map(RealParts::read).transpose()?;
    output::folder(&args.out)?;
    let load = |name, what, count| {
        let bar = progress(name, count as u64);
        let loaded = source.map(what, count, &bar, |mut episode| {
            let frames = episode.frames();
            if let (Use::Train, Some(parts)) = (what, &real_parts) {
                parts.add(&mut episode);
            }
            ensure!(
                what != Use::Train || frames >= args.frames,
                "{frames} frames are fewer than a training sequence has: --frames is {}",
                args.frames
            );
            Features::from_episode(&episode)
        });
        bar.finish();
        loaded
    };
    let mut train = load("train", Use::Train, args.episodes)?;
    let validation_episodes = args.episodes.div_ceil(12).max(2);
    let validation = load("validation", Use::Validation, validation_episodes)?;
    let validation_objects = match &source {
        Source::Folder(folder) => folder.choose(Use::Validation, validation_episodes)?.objects,
        Source::Generated { .. } => objects::of_group(Group::Val).map(|o| o.name.clone()).collect(),
    };
    let total: usize = train.iter().map(Features::frames).sum();
    if args.mine_hours > 0.0 {
        let bar = progress("mine", 0);
        train.extend(mine(&first, args.seed, args.mine_hours, real_parts.as_ref(), &bar)?);
        bar.finish();
    }
    if let Some(folder) = &args.mined {
        train.extend(mining::read(folder)?);
    }
    let mined = train.iter().filter(|features| features.mined).count();
    let options = Options { extreme_weight: Some(args.extreme_weight), ..Options::default() };
    let sampler = Sampler::new(&train, args.frames, options)?;
    let steps = total.div_ceil(args.batch * args.frames);
    let run = Run { args, teachers, first, steps };
    let recipe = run.recipe(&source)?;

    let mut optimizer = optimizer();
    let mut state = if args.resume {
        let (state, restored) = Checkpoint::read(&args.out, &recipe, optimizer)?;
        optimizer = restored;
        state
    } else {
        let weights = run.first.clone();
        Checkpoint { average: weights.clone(), weights, rows: Vec::new(), recipe }
    };

    let mut network = FloatNetwork::new(&state.weights, &device);
    for epoch in state.rows.len()..args.epochs {
        let started = Instant::now();
        let train_loss = run.epoch(epoch, &sampler, &mut network, &mut optimizer, &mut state)?;
        let (scores, detector, validation_loss) = validate(&state.average, &validation);
        state.rows.push(Row {
            epoch: epoch + 1,
            step: (epoch + 1) * steps,
            learning_rate: run.learning_rate((epoch + 1) * steps - 1),
            train_loss,
            validation_loss: Some(validation_loss),
            validation_accuracy: scores.classes.accuracy(),
            validation_macro_f1: scores.classes.macro_f1(),
            validation_fpr: scores.classes.fpr_of_non_slip(),
            validation_missed: detector.missed,
            validation_latency: detector.median_latency_frames,
            seconds: state.rows.last().map_or(0.0, |r| r.seconds) + started.elapsed().as_secs_f64(),
        });
        state.write(&args.out, &optimizer)?;
        write_curves(&args.out, &state.rows)?;
        let table = csv(&state.rows);
        println!("{}", if epoch == 0 { table.trim_end() } else { table.lines().last().unwrap_or_default() });
    }
    let made_from = json!({
        "train_episodes": train.len() - mined,
        "mined_stretches": mined,
        "train_frames_by_class": sampler.class_frames(),
        "validation_episodes": validation.len(),
        "validation_objects": validation_objects,
    });
    finish(args, &state, made_from)
}

/// The weights that the first step finds.
fn first_weights(args: &TrainArgs) -> Result<Weights> {
    let Some(path) = &args.start else {
        return Ok(Weights::init(args.dims(), args.seed));
    };
    let weights = Weights::read(path)?;
    let [sizes, wanted] = [weights.dims, args.dims()].map(|dims| dims.to_fields());
    let (path, size) = (path.display(), args.size);
    ensure!(
        sizes == wanted,
        "--start {path}: sizes are {sizes:?}, with --size {size} they must be {wanted:?}"
    );
    Ok(weights)
}

fn write_curves(out: &Path, rows: &[Row]) -> Result<()> {
    output::write(&out.join("curves.csv"), csv(rows).as_bytes())?;
    output::write(&out.join("curves.svg"), curves::svg(rows)?.as_bytes())
}

fn finish(args: &TrainArgs, state: &Checkpoint, made_from: serde_json::Value) -> Result<()> {
    let path = args.out.join(WEIGHTS);
    state.average.write(&path)?;
    write_curves(&args.out, &state.rows)?;
    let mut manifest = made_from;
    manifest["recipe"] = json!(state.recipe);
    manifest["parameters"] = json!(state.average.count());
    manifest["last_epoch"] = json!(state.rows.last());
    manifest["weights_sha256"] = json!(output::sha256_hex(&state.average.to_bytes()?));
    output::write_json(&args.out.join(RECORD), &manifest)?;
    println!("{}", path.display());
    Ok(())
}

/// What does not change in a run.
struct Run<'a> {
    args: &'a TrainArgs,
    teachers: Vec<Weights>,
    first: Weights,
    /// Per epoch.
    steps: usize,
}

impl Run<'_> {
    /// What makes two runs the same, for the manifest and for --resume.
    fn recipe(&self, source: &Source) -> Result<serde_json::Value> {
        let args = self.args;
        let mut recipe = json!({
            "data": source.describe(),
            "episodes": args.episodes,
            "epochs": args.epochs,
            "steps_per_epoch": self.steps,
            "seed": args.seed,
            "batch": args.batch,
            "frames": args.frames,
            "learning_rate": args.learning_rate,
            "extreme_weight": args.extreme_weight,
            "warm_up": WARM_UP,
            "weight_decay": WEIGHT_DECAY,
            "average_decay": AVERAGE_DECAY,
            "dims": args.dims().to_fields(),
        });
        if args.data.is_some() {
            recipe["objects"] = json!(args.object_uses());
        }
        let hash = |weights: &Weights| anyhow::Ok(output::sha256_hex(&weights.to_bytes()?));
        if args.real_parts.is_some() {
            recipe["real_parts"] = json!(true);
        }
        if args.mine_hours > 0.0 {
            recipe["mine_hours"] = json!(args.mine_hours);
        }
        if let Some(folder) = &args.mined {
            recipe["mined"] = mining::settings(folder)?;
        }
        if args.device != DeviceName::Cpu {
            recipe["device"] = json!(args.device);
        }
        if args.start.is_some() {
            recipe["start_sha256"] = json!(hash(&self.first)?);
        }
        if !self.teachers.is_empty() {
            recipe["teacher_sha256"] = json!(self.teachers.iter().map(hash).collect::<Result<Vec<_>>>()?);
        }
        Ok(recipe)
    }

    fn learning_rate(&self, step: usize) -> f64 {
        self.args.learning_rate * schedule(step, self.args.epochs * self.steps)
    }

    /// One epoch; the mean loss.
    fn epoch(
        &self,
        epoch: usize,
        sampler: &Sampler<'_>,
        network: &mut FloatNetwork,
        optimizer: &mut ModuleOptimizer,
        state: &mut Checkpoint,
    ) -> Result<f64> {
        let bar = progress(format!("epoch {}/{}", epoch + 1, self.args.epochs), self.steps as u64);
        let (mut sum, mut recent) = (0.0, None);
        let teachers = self.teachers.iter().map(|weights| (weights.dims, weights));
        let teacher = Teacher::new(teachers, &network.device().inner());
        for step in epoch * self.steps..(epoch + 1) * self.steps {
            let mut batch = sampler.batch(self.args.batch, self.args.seed.wrapping_add((step as u64) << 32));
            teacher.teach(&mut batch);
            let (value, gradients) = network.gradients(&state.weights.dims, &batch);
            ensure!(value.is_finite(), "the loss is {value} at step {step}: try a lower --learning-rate");
            *network = optimizer.step(self.learning_rate(step), network.clone(), gradients);
            state.weights = network.weights(state.weights.dims);
            state.average.average(&state.weights, average_decay(step));
            sum += value;
            let loss = recent.map_or(value, |recent| 0.95 * recent + 0.05 * value);
            recent = Some(loss);
            bar.set_message(format!("loss {loss:.3}"));
            bar.inc(1);
        }
        bar.finish_and_clear();
        Ok(sum / self.steps as f64)
    }
}

/// Classes, detector and mean cross entropy (nat) over whole episodes.
fn validate(weights: &Weights, episodes: &[Features]) -> (Scores, DetectorFigures, f64) {
    let network = FloatNetwork::new(weights, &Device::flex());
    let outputs = |features: &Features| network.outputs(&weights.dims, &features.sequences());
    let outputs: Vec<_> = episodes.iter().map(|features| (features, outputs(features))).collect();
    let (mut scores, mut loss, mut frames) = (Scores::default(), 0.0, 0.0);
    for (features, logits) in &outputs {
        scores.add(score_logits(features, logits));
        for (logits, &class) in logits.iter().zip(&features.label) {
            loss += cross_entropy(logits, class);
            frames += 1.0;
        }
    }
    (scores, detector_figures(&outputs, VALIDATION_ALARMS_PER_HOUR), loss / frames)
}

fn cross_entropy(outputs: &[f32; OUTPUTS], class: u8) -> f64 {
    let logits = &outputs[..CLASSES];
    let max = logits.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = logits.iter().map(|x| (x - max).exp()).sum();
    f64::from(max + sum.ln() - logits[class as usize])
}
