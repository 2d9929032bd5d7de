//! Training of one variant, alone or with a teacher, within the budget that all share.

use anyhow::{Result, ensure};
use burn::module::Module;
use burn::optim::GradientsParams;
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

/// Train from first weights and draws that follow from `seed`; `sampler` has the variant's options, `device` is a plain
/// one. `bar` moves once a step. A teacher, with its trained weights, sees the batches as they are drawn.
pub fn train(
    variant: &Variant,
    sampler: &Sampler<'_>,
    teacher: Option<(Variant, &Weights)>,
    budget: &Budget,
    seed: u64,
    device: &Device,
    bar: &ProgressBar,
) -> Result<Trained> {
    let teacher = Teacher::new(teacher, device.clone());
    let device = device.clone().autodiff();
    let mut weights = variant.first_weights(seed);
    let network = FloatNetwork::new(&weights, &device);
    let gradients = |network: &FloatNetwork, step: usize| {
        let mut batch = sampler.batch(budget.batch, seed.wrapping_add((step as u64) << 32));
        teacher.teach(&mut batch);
        network.gradients(variant, &batch, &device)
    };
    let average = |network: &FloatNetwork, decay| weights.average(&network.weights(variant.dims()), decay);
    let loss = run_steps(network, budget.steps, budget.learning_rate, bar, gradients, average)?;
    Ok(Trained { weights, loss })
}

/// Steps that all networks take alike, with a highest learning rate. `gradients`: of a step, with its loss; `average`
/// gets every step's module and the decay of the running average. Returns the mean loss of the last tenth.
pub(super) fn run_steps<M: Module>(
    mut module: M,
    steps: usize,
    learning_rate: f64,
    bar: &ProgressBar,
    mut gradients: impl FnMut(&M, usize) -> (f64, GradientsParams),
    mut average: impl FnMut(&M, f32),
) -> Result<f64> {
    let mut optimizer = optimizer();
    let mut losses = Vec::with_capacity(steps);
    for step in 0..steps {
        let (loss, gradients) = gradients(&module, step);
        ensure!(loss.is_finite(), "the loss is {loss} at step {step}: try a lower --learning-rate");
        module = optimizer.step(learning_rate * schedule(step, steps), module, gradients);
        average(&module, average_decay(step));
        losses.push(loss);
        bar.set_message(format!("loss {loss:.3}"));
        bar.inc(1);
    }
    let last = &losses[steps - steps.div_ceil(LAST_SHARE)..];
    Ok(last.iter().sum::<f64>() / last.len() as f64)
}
