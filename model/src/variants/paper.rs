//! The paper's networks: encoders of its own, and the fusion that ours has as well, with embeddings of 128.
//!
//! What is not stated there is as in ours: the bias by lag, the four heads, the loss of every frame instead of the
//! last one's, the detector's output beside the logits. A network sees counts and standardised bins, nothing else.

use anyhow::Result;
use burn::module::Module;
use burn::optim::{GradientsAccumulator, GradientsParams};
use burn::tensor::{Device, Int, Tensor};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use slipsense::net::format::TensorSpec;
use slipsense::params::{MEL_BINS, OUTPUTS, PIEZO_CHANNELS, TAXELS, XL_FEATURES};
use std::path::Path;

use super::train::Training;
use super::{BASE, Encoders, Variant};
use crate::device::{numbers, tensor};
use crate::encoders::named::{self, Named};
use crate::encoders::{EMBED, Encoder, MaskedPatches, PadEncoder, SsastPretraining, VitMae};
use crate::float::{Architecture, FloatNetwork, Graph, Sequences, Step, plain};
use crate::piezo::{IMAGE, PIEZO_INPUT_SCALE};
use crate::weights::{Weights, first_values};

/// Scans of a step of the masked autoencoder's pretraining, and windows of a step of SSAST's.
const PRETRAINING_SCANS: usize = 64;
const PRETRAINING_WINDOWS: usize = 16;
/// Highest learning rate of an encoder, as a share of the fusion's: transformers do not bear more.
const RATE_SHARE: f64 = 0.1;

/// The fusion of a variant, its encoders left out. Features are both embeddings side by side.
struct Fusion(Variant);

impl Architecture for Fusion {
    fn specs(&self) -> Vec<TensorSpec> {
        let is_encoder =
            |spec: &TensorSpec| spec.layer.starts_with("piezo.") || spec.layer.starts_with("xl.");
        self.0.specs().into_iter().filter(|spec| !is_encoder(spec)).collect()
    }

    fn forward(&self, graph: &Graph<'_>, input: &Sequences, features: Option<Tensor<2>>) -> Tensor<3> {
        let part = |at: usize| features.clone().map(|both| both.narrow(1, at * EMBED, EMBED));
        self.0.decide(graph, input, part(0), part(1))
    }
}

/// Scans that differ: untouched pads are all alike, and are embedded once.
struct Scans {
    /// Counts as they enter, the untouched pad first.
    rows: Vec<f32>,
    /// Row of every scan of the batch.
    row: Vec<i32>,
}

impl Scans {
    fn new(input: &Sequences) -> Self {
        let mut scans = Self { rows: vec![0.0; TAXELS], row: Vec::new() };
        for image in input.piezo.chunks_exact(IMAGE) {
            let counts = || image.iter().step_by(PIEZO_CHANNELS);
            if counts().all(|&count| count == 0) {
                scans.row.push(0);
                continue;
            }
            scans.row.push((scans.rows.len() / TAXELS) as i32);
            scans.rows.extend(counts().map(|&count| f32::from(count) * PIEZO_INPUT_SCALE));
        }
        scans
    }
}

/// Standardised bins of every frame, `[sequence and sensor, frame, bin]`.
fn bins(input: &Sequences) -> Vec<f32> {
    input.xl.chunks_exact(XL_FEATURES).flat_map(|frame| &frame[..MEL_BINS]).copied().collect()
}

/// Embeddings `[scan, embedding]` of all rows, a few at a time, without a tape. `seed`: of what is dropped.
fn embed(encoder: &Encoder, rows: &[f32], width: usize, seed: u64, device: &Device) -> Tensor<2> {
    let some = |(part, rows): (usize, &[f32])| {
        let rows = tensor::<2>(rows.to_vec(), [rows.len() / width, width], device);
        numbers(encoder.embed(rows, seed + part as u64))
    };
    let parts = rows.chunks(encoder.rows_at_once(device) * width).enumerate();
    let embedded: Vec<f32> = parts.flat_map(some).collect();
    let scans = embedded.len() / EMBED;
    tensor(embedded, [scans, EMBED], device)
}

#[derive(Module, Debug)]
pub struct PaperNetwork {
    pads: Encoder,
    xl: Encoder,
    fusion: FloatNetwork,
}

impl PaperNetwork {
    /// Before training. To be trained on a device with automatic gradients, to be run on a plain one.
    pub fn new(variant: &Variant, encoders: Encoders, seed: u64, device: &Device) -> Self {
        let fusion = Weights { dims: variant.dims(), tensors: first_values(&Fusion(*variant).specs(), seed) };
        Self {
            pads: named::first(Encoder::of_pads(encoders.pads, device), seed),
            xl: named::first(Encoder::of_xl(encoders.xl, device), seed + 1),
            fusion: FloatNetwork::new(&fusion, device),
        }
    }

    /// With pretrained encoders where they are there; a frozen one is not trained on.
    fn with_pretrained(mut self, pretrained: &Pretrained, is_frozen: bool) -> Self {
        if let (Encoder::Vit(vit), Some(numbers)) = (&self.pads, &pretrained.vit) {
            self.pads = Encoder::Vit(named::put(vit.clone(), numbers));
        }
        if let (Encoder::Ssast(ssast), Some(numbers)) = (&self.xl, &pretrained.ssast) {
            self.xl = Encoder::Ssast(named::put(ssast.clone(), numbers));
        }
        if is_frozen {
            self.pads = self.pads.freeze();
        }
        self
    }

    /// Outputs of every frame, `[batch, frame]`, of a network that is to be run.
    pub fn outputs(&self, variant: &Variant, input: &Sequences) -> Vec<[f32; OUTPUTS]> {
        let device = &self.fusion.device();
        let scans = Scans::new(input);
        let pads = embed(&self.pads, &scans.rows, TAXELS, 0, device);
        let xl = embed(&self.xl, &bins(input), input.frames * MEL_BINS, 0, device);
        let fusion = Fusion(*variant);
        plain(fusion.forward(&self.fusion.graph(&fusion), input, Some(features(pads, xl, &scans.row))))
    }

    /// Of a batch, by a network that is to be trained. The encoders run twice, a few rows at a time: their activations
    /// would fill the memory.
    pub fn gradients(&self, variant: &Variant, is_frozen: bool, input: &Sequences, seed: u64) -> Step {
        let device = &self.fusion.device();
        let (scans, bins) = (Scans::new(input), bins(input));
        let frames = input.frames * MEL_BINS;
        let pads = embed(&self.pads, &scans.rows, TAXELS, seed, device).require_grad();
        let xl = embed(&self.xl, &bins, frames, seed, device).require_grad();
        let fusion = Fusion(*variant);
        let seen = features(pads.clone(), xl.clone(), &scans.row);
        let outputs = fusion.forward(&self.fusion.graph(&fusion), input, Some(seen));
        let loss = FloatNetwork::loss(outputs, input);
        let value = f64::from(loss.clone().into_scalar::<f32>());
        let mut gradients = loss.backward();
        let mut of = |leaf: &Tensor<2>| {
            numbers(leaf.grad_remove(&mut gradients).expect("the loss depends on every embedding"))
        };
        let (of_pads, of_xl) = (of(&pads), of(&xl));
        let mut sum = GradientsAccumulator::new();
        sum.accumulate(self, GradientsParams::from_grads(gradients, self));
        if !is_frozen {
            self.backward(&self.pads, (&scans.rows, TAXELS), &of_pads, seed, &mut sum);
        }
        self.backward(&self.xl, (&bins, frames), &of_xl, seed, &mut sum);
        (value, sum.grads())
    }

    /// Add an encoder's gradients, from those of its embeddings.
    fn backward(
        &self,
        encoder: &Encoder,
        (rows, width): (&[f32], usize),
        gradient: &[f32],
        seed: u64,
        sum: &mut GradientsAccumulator<Self>,
    ) {
        let device = &self.fusion.device();
        let out = gradient.len() / (rows.len() / width);
        let at_once = encoder.rows_at_once(device);
        let parts = rows.chunks(at_once * width).zip(gradient.chunks(at_once * out));
        for (part, (rows, gradient)) in parts.enumerate() {
            let count = rows.len() / width;
            let rows = tensor(rows.to_vec(), [count, width], device);
            let embedded = encoder.embed(rows, seed + part as u64);
            let gradients = (embedded * tensor(gradient.to_vec(), [count, out], device)).sum().backward();
            sum.accumulate(self, GradientsParams::from_grads(gradients, self));
        }
    }
}

/// Both embeddings of every scan side by side.
fn features(pads: Tensor<2>, xl: Tensor<2>, row: &[i32]) -> Tensor<2> {
    let row = Tensor::<1, Int>::from_data(row, &pads.device());
    Tensor::cat(vec![pads.select(0, row), xl], 1)
}

/// Encoders that were trained without labels.
#[derive(Clone, Debug, Default)]
pub struct Pretrained {
    pub vit: Option<Named>,
    pub ssast: Option<Named>,
}

impl Training<'_> {
    fn encoder_batch(&self, step: usize) -> Sequences {
        self.batch(self.budget.encoder_batch, step)
    }

    /// The running average of a module's numbers over all steps, and the last tenth's mean loss.
    fn run<M: Module>(&self, module: M, gradients: impl FnMut(&M, usize) -> Step) -> Result<(Named, f64)> {
        let rate = RATE_SHARE * self.budget.learning_rate;
        let mut numbers = named::get(&module);
        let average = |module: &M, decay| named::average(&mut numbers, &named::get(module), decay);
        let loss = self.steps(module, self.budget.encoder_steps, rate, gradients, average)?;
        Ok((numbers, loss))
    }

    /// Train a network of the paper's on the labels.
    pub fn paper(
        &self,
        variant: &Variant,
        encoders: Encoders,
        pretrained: &Pretrained,
    ) -> Result<(Named, f64)> {
        let is_frozen = encoders.pads == PadEncoder::VitFrozen;
        let network = PaperNetwork::new(variant, encoders, self.seed, &self.device.clone().autodiff());
        let network = network.with_pretrained(pretrained, is_frozen);
        self.run(network, |network, step| {
            network.gradients(variant, is_frozen, &self.encoder_batch(step), self.step_seed(step))
        })
    }

    /// The vision transformer as a masked autoencoder of the training episodes' touched pads.
    pub fn pretrain_vit(&self) -> Result<Named> {
        let device = self.device.clone().autodiff();
        let mae = named::first(VitMae::new(&device), self.seed);
        let (numbers, _) = self.run(mae, |mae, step| {
            let mut rng = ChaCha8Rng::seed_from_u64(self.step_seed(step));
            let scans = Scans::new(&self.encoder_batch(step)).rows;
            // Spread over the batch; the untouched pad is the first.
            let apart = (scans.len() / TAXELS).div_ceil(PRETRAINING_SCANS).max(1);
            let some = scans.chunks_exact(TAXELS).skip(1).step_by(apart);
            let some: Vec<f32> =
                some.filter(|_| MaskedPatches::has_any(&mut rng)).flatten().copied().collect();
            let count = some.len() / TAXELS;
            if count == 0 {
                return (0.0, GradientsParams::new());
            }
            let masked = MaskedPatches::draw(count, &mut rng);
            of_loss(mae, mae.loss(tensor(some, [count, TAXELS], &device), &masked))
        })?;
        Ok(part(numbers, "vit."))
    }

    /// SSAST on masked frames of the training episodes' log-mel.
    pub fn pretrain_ssast(&self) -> Result<Named> {
        let device = self.device.clone().autodiff();
        let ssast = named::first(SsastPretraining::new(&device), self.seed);
        let (numbers, _) = self.run(ssast, |ssast, step| {
            let mut rng = ChaCha8Rng::seed_from_u64(self.step_seed(step));
            let bins = bins(&self.encoder_batch(step));
            let window = BASE.window.min(self.budget.encoder_frames);
            let windows: Vec<f32> =
                bins.chunks_exact(window * MEL_BINS).take(PRETRAINING_WINDOWS).flatten().copied().collect();
            let count = windows.len() / (window * MEL_BINS);
            of_loss(ssast, ssast.loss(tensor(windows, [count, window, MEL_BINS], &device), &mut rng))
        })?;
        Ok(part(numbers, "ssast."))
    }
}

/// A loss as a number, and its gradients.
fn of_loss(module: &impl Module, loss: Tensor<1>) -> Step {
    let value = f64::from(loss.clone().into_scalar::<f32>());
    (value, GradientsParams::from_grads(loss.backward(), module))
}

/// The numbers of one part of a module.
fn part(numbers: Named, prefix: &str) -> Named {
    let own = |(name, numbers): (String, _)| Some((name.strip_prefix(prefix)?.to_owned(), numbers));
    numbers.into_iter().filter_map(own).collect()
}

/// The numbers of such a module that an earlier run kept in a file; made, and kept, where there is none.
pub fn kept(path: &Path, module: &impl Module, make: impl FnOnce() -> Result<Named>) -> Result<Named> {
    if path.exists() {
        return named::read(path, module);
    }
    let made = make()?;
    crate::output::write(path, &named::to_bytes(&made)?)?;
    Ok(made)
}
