//! Training of one variant, alone or with a teacher, within the budget that all share.

use anyhow::{Result, ensure};
use burn::module::Module;
use burn::tensor::Device;
use indicatif::ProgressBar;

use super::Variant;
use super::results::Budget;
use crate::batch::Sampler;
use crate::float::{FloatNetwork, Sequences, Step};
use crate::teacher::Teacher;
use crate::train::{average_decay, optimizer, schedule};
use crate::weights::Weights;

/// Share of the steps, the last ones, over which the loss is averaged.
const LAST_SHARE: usize = 10;

/// What does not change while a network is trained.
#[derive(Clone, Copy, Debug)]
pub struct Training<'a> {
    /// Has the variant's options.
    pub sampler: &'a Sampler<'a>,
    pub budget: &'a Budget,
    /// Of first weights and draws.
    pub seed: u64,
    /// A plain one.
    pub device: &'a Device,
    /// Moves once a step.
    pub bar: &'a ProgressBar,
}

impl Training<'_> {
    /// Train one of our networks from the weights `start`, else from random ones: the running average of its weights, and
    /// the mean loss of the last tenth of the steps, nat.
    pub fn ours(
        &self,
        variant: &Variant,
        start: Option<&Weights>,
        teacher: Option<(Variant, &Weights)>,
    ) -> Result<(Weights, f64)> {
        let teacher = Teacher::new(teacher, self.device);
        let mut weights = start.cloned().unwrap_or_else(|| variant.first_weights(self.seed));
        let network = FloatNetwork::new(&weights, &self.device.clone().autodiff());
        let gradients = |network: &FloatNetwork, step: usize| {
            let mut batch = self.batch(self.budget.batch, step);
            teacher.teach(&mut batch);
            network.gradients(variant, &batch)
        };
        let average =
            |network: &FloatNetwork, decay| weights.average(&network.weights(variant.dims()), decay);
        let loss = self.steps(network, self.budget.steps, self.budget.learning_rate, gradients, average)?;
        Ok((weights, loss))
    }

    pub(super) fn batch(&self, sequences: usize, step: usize) -> Sequences {
        self.sampler.batch(sequences, self.step_seed(step))
    }

    pub(super) fn step_seed(&self, step: usize) -> u64 {
        self.seed.wrapping_add((step as u64) << 32)
    }

    /// Steps that all networks take alike, with a highest learning rate. `gradients`: of a step, with its loss;
    /// `average` gets every step's module and the decay of the running average. Returns the mean loss of the last tenth.
    pub(super) fn steps<M: Module>(
        &self,
        mut module: M,
        steps: usize,
        learning_rate: f64,
        mut gradients: impl FnMut(&M, usize) -> Step,
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
            self.bar.set_message(format!("loss {loss:.3}"));
            self.bar.inc(1);
        }
        let last = &losses[steps - steps.div_ceil(LAST_SHARE)..];
        Ok(last.iter().sum::<f64>() / last.len() as f64)
    }
}
