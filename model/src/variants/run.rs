//! One row and seed of `slipsense reproduce`, trained and scored.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use burn::tensor::Device;
use indicatif::{MultiProgress, ProgressBar};
use slipsense::net::Model;
use slipsense::params::OUTPUTS;

use super::orderings::UMI;
use super::paper::{PaperNetwork, Pretrained, kept};
use super::results::{Budget, Finished};
use super::sets::{SPLITS, Sets};
use super::train::Training;
use super::{Making, ROWS, Row, Variant, example, integers, row_named};
use crate::batch::{Options, Sampler};
use crate::data::{Features, is_of_laboratory};
use crate::device::DeviceName;
use crate::encoders::{PadEncoder, Ssast, Vit, XlEncoder, named};
use crate::float::FloatNetwork;
use crate::mining::mine;
use crate::progress::progress;
use crate::weights::Weights;

/// Disturbances that are searched for hard examples, seconds for each training episode.
const SEARCHED_S: f64 = 7.5;
/// Runs of a window, of which the median counts.
const WINDOW_RUNS: usize = 5;

/// What all rows share.
pub(super) struct Run<'a> {
    pub out: &'a Path,
    pub budget: &'a Budget,
    pub sets: &'a Sets,
    pub device_name: DeviceName,
    /// A plain one of this name.
    pub device: Device,
    /// The authors' SSAST-Tiny.
    pub ssast: Option<&'a Path>,
    pub bars: &'a MultiProgress,
    /// By seed: held by the row that pretrains an encoder, which others of this seed may need too.
    pub pretraining: BTreeMap<u64, Mutex<()>>,
}

impl Run<'_> {
    /// Train, where the row is trained, and score.
    pub fn ours(&self, row: &Row, seed: u64) -> Result<Finished> {
        let Self { out, budget, device, .. } = self;
        let started = Instant::now();
        let needed =
            row.needs().and_then(row_named).map(|needed| read_kept(out, needed, seed)).transpose()?;
        let needed = needed.as_ref().map(|(variant, weights)| (*variant, weights));
        if let (Making::Quantized, Some((_, weights))) = (row.making, needed) {
            return self.integers(row, seed, weights, started);
        }
        let (start, teacher) = match row.making {
            Making::TrainedOn { .. } => (needed.map(|(_, weights)| weights), None),
            _ => (None, needed),
        };
        let bar = self.bar(row, seed, 0);
        let mined = match (row.making, start) {
            (Making::TrainedOn { mined: true }, Some(start)) => {
                let hours = SEARCHED_S * budget.episodes as f64 / 3600.0;
                mine(start, seed, hours, None, &bar)?
            }
            _ => Vec::new(),
        };
        bar.set_position(0);
        bar.set_length(budget.steps as u64);
        let sampler = self.sampler(row, &mined, budget.frames)?;
        let training = Training { sampler: &sampler, budget, seed, device, bar: &bar };
        let (weights, loss) = training
            .ours(&row.variant, start, teacher)
            .with_context(|| format!("row {}, seed {seed}", row.name))?;
        bar.finish_and_clear();
        if ROWS.iter().any(|other| other.needs() == Some(row.name)) {
            weights.write(&kept_weights(out, row.name, seed))?;
        }
        let network = FloatNetwork::new(&weights, device);
        let outputs =
            |features: &Features| network.outputs(&row.variant, &features.sequences_of(row.variant.pads));
        let finished = self.finished(row, seed, started, weights.count(), outputs);
        Ok(Finished { loss: Some(loss), ..finished })
    }

    /// A row's trained weights on the microcontroller's kernels.
    fn integers(&self, row: &Row, seed: u64, weights: &Weights, started: Instant) -> Result<Finished> {
        let bytes = integers::model(weights, &self.sets.train)
            .with_context(|| format!("row {}, seed {seed}", row.name))?;
        let model = Model::parse(&bytes)?;
        let outputs = |features: &Features| integers::outputs(model, features);
        let finished = self.finished(row, seed, started, weights.count(), outputs);
        Ok(Finished { device: DeviceName::Cpu, ..finished })
    }

    /// What a network reaches by its outputs on the first episodes of the row's splits, without loss.
    fn finished(
        &self,
        row: &Row,
        seed: u64,
        started: Instant,
        parameters: usize,
        outputs: impl Fn(&Features) -> Vec<[f32; OUTPUTS]>,
    ) -> Finished {
        let (splits, episodes) = match row.encoders {
            Some(_) => (&UMI[..], self.budget.encoder_test_episodes),
            None => (&SPLITS[..], self.budget.test_episodes),
        };
        let bar = self.bar(row, seed, 0);
        bar.set_message("score");
        let pads_say_contact = row.variant.pads_say_contact();
        let splits = self.sets.score(splits, episodes, pads_say_contact, &bar, &outputs);
        let has_detector = row.encoders.is_none() && pads_say_contact;
        let detector = has_detector.then(|| self.sets.detector(&bar, &outputs));
        bar.finish_and_clear();
        Finished {
            row: row.name.to_owned(),
            seed,
            synthetic: true,
            budget: self.budget.clone(),
            device: self.device_name,
            parameters,
            loss: None,
            example: example::of(row, self.sets, &outputs),
            window_ms: window_ms(self.sets, outputs),
            wall_s: started.elapsed().as_secs_f64(),
            splits,
            detector,
        }
    }

    /// The same for a row with the paper's encoders; pretrains those it needs that no earlier row has needed.
    pub fn paper(&self, row: &Row, seed: u64) -> Result<Finished> {
        let Self { out, budget, device, .. } = self;
        let started = Instant::now();
        let encoders = row.encoders.context("the row has encoders")?;
        let sampler = self.sampler(row, &[], budget.encoder_frames)?;
        let bar = self.bar(row, seed, budget.encoder_steps);
        let training = Training { sampler: &sampler, budget, seed, device, bar: &bar };
        let mut pretrained = Pretrained::default();
        let pretraining = self.pretraining[&seed].lock().expect("no row panics with the lock");
        if matches!(encoders.pads, PadEncoder::VitFrozen | PadEncoder::VitFinetuned) {
            bar.set_message("ViT-MAE");
            let path = out.join(format!("vit-mae-{seed}.safetensors"));
            pretrained.vit = Some(kept(&path, &Vit::new(device), || training.pretrain_vit())?);
            bar.reset();
        }
        if encoders.xl == XlEncoder::Ssast {
            bar.set_message("SSAST");
            let path = out.join(format!("ssast-{seed}.safetensors"));
            pretrained.ssast = Some(match self.ssast {
                Some(authors) => authors_ssast(authors)?,
                None => kept(&path, &Ssast::new(device), || training.pretrain_ssast())?,
            });
            bar.reset();
        }
        drop(pretraining);
        let (numbers, loss) = training
            .paper(&row.variant, encoders, &pretrained)
            .with_context(|| format!("row {}, seed {seed}", row.name))?;
        bar.finish_and_clear();
        let network = named::put(PaperNetwork::new(&row.variant, encoders, seed, device), &numbers);
        let outputs =
            |features: &Features| network.outputs(&row.variant, &features.sequences_of(row.variant.pads));
        let trained = numbers.iter().filter(|(name, _)| !name.contains("running_"));
        let parameters = trained.map(|(_, numbers)| numbers.values.len()).sum();
        Ok(Finished { loss: Some(loss), ..self.finished(row, seed, started, parameters, outputs) })
    }

    /// Of the training episodes that the row sees, and of mined stretches.
    fn sampler<'s>(&'s self, row: &Row, mined: &'s [Features], frames: usize) -> Result<Sampler<'s>> {
        let Variant { pads, xl_augmentation, families, event_loss, learns_contact, .. } = row.variant;
        let extreme_weight = Options::default().extreme_weight.filter(|_| event_loss);
        let seen =
            self.sets.train.iter().enumerate().filter(|(place, _)| families || is_of_laboratory(*place));
        let episodes = seen.map(|(_, episode)| episode).chain(mined);
        let options = Options { pads, xl_augmentation, extreme_weight, learns_contact };
        Sampler::new(episodes, frames, options)
    }

    fn bar(&self, row: &Row, seed: u64, steps: usize) -> ProgressBar {
        self.bars.add(progress(format!("{} {seed}", row.name), steps as u64))
    }
}

/// Median of some runs of one window, which is in memory; none where no episode slips.
fn window_ms<T>(sets: &Sets, outputs: impl Fn(&Features) -> T) -> Option<f64> {
    let window = sets.window()?;
    let run = |_| {
        let started = Instant::now();
        std::hint::black_box(outputs(&window));
        1e3 * started.elapsed().as_secs_f64()
    };
    let mut times: Vec<f64> = (0..WINDOW_RUNS).map(run).collect();
    times.sort_by(f64::total_cmp);
    Some(times[WINDOW_RUNS / 2])
}

/// The authors' transformer by our names.
pub(super) fn authors_ssast(path: &Path) -> Result<named::Named> {
    let ssast = named::first(Ssast::new(&Device::flex()), 1).with_authors(path)?;
    Ok(named::get(&ssast))
}

/// Where the weights of a row are kept that others need.
pub(super) fn kept_weights(out: &Path, row: &str, seed: u64) -> PathBuf {
    out.join(format!("{row}-{seed}.safetensors"))
}

fn read_kept(out: &Path, row: &Row, seed: u64) -> Result<(Variant, Weights)> {
    let path = kept_weights(out, row.name, seed);
    let weights = Weights::read(&path)?;
    ensure!(weights.dims == row.variant.dims(), "{}: not the dimensions of row {}", path.display(), row.name);
    Ok((row.variant, weights))
}
