//! Training of one variant, alone or with a teacher, within the budget that all share.

use anyhow::{Result, ensure};
use burn::tensor::Device;
use indicatif::ProgressBar;

use super::Variant;
use super::results::Budget;
use crate::batch::Sampler;
use crate::float::FloatNetwork;
use crate::teacher::Teacher;
use crate::train::{average_decay, optimizer, schedule};
use crate::weights::Weights;

/// Share of the steps, the last ones, over which the loss is averaged.
const LAST_SHARE: usize = 10;

#[derive(Clone, Debug)]
pub struct Trained {
    /// Running average of the weights.
    pub weights: Weights,
    /// Mean over the last tenth of the steps, nat.
    pub loss: f64,
}

#[derive(Clone, Debug)]
pub struct TrainedNetwork {
    pub variant: Variant,
    pub weights: Weights,
}

/// Train from first weights and draws that follow from `seed`; `sampler` has the variant's options, `device` is a plain
/// one. `bar` moves once a step. A teacher sees the batches as they are drawn.
pub fn train(
    variant: &Variant,
    sampler: &Sampler<'_>,
    teacher: Option<&TrainedNetwork>,
    budget: &Budget,
    seed: u64,
    device: &Device,
    bar: &ProgressBar,
) -> Result<Trained> {
    let mut optimizer = optimizer();
    let teacher = Teacher::new(teacher.map(|of| (of.variant, &of.weights)), device.clone());
    let device = device.clone().autodiff();
    let first = variant.first_weights(seed);
    let mut network = FloatNetwork::new(&first, &device);
    let mut average = first;
    let mut losses = Vec::with_capacity(budget.steps);
    for step in 0..budget.steps {
        let mut batch = sampler.batch(budget.batch, seed.wrapping_add((step as u64) << 32));
        teacher.teach(&mut batch);
        let (loss, gradients) = network.gradients(variant, &batch, &device);
        ensure!(loss.is_finite(), "the loss is {loss} at step {step}: try a lower --learning-rate");
        let rate = budget.learning_rate * schedule(step, budget.steps);
        network = optimizer.step(rate, network, gradients);
        average.average(&network.weights(variant.dims()), average_decay(step));
        losses.push(loss);
        bar.set_message(format!("loss {loss:.3}"));
        bar.inc(1);
    }
    let last = &losses[budget.steps - budget.steps.div_ceil(LAST_SHARE)..];
    Ok(Trained { weights: average, loss: last.iter().sum::<f64>() / last.len() as f64 })
}
