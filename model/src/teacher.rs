//! Trained networks that another one learns from: what they say of a batch counts beside the labels.

use burn::tensor::Device;

use crate::float::{Architecture, FloatNetwork, Sequences};
use crate::weights::Weights;

/// Networks of one kind, ready to be asked; none where nobody teaches.
#[derive(Debug)]
pub struct Teacher<A> {
    networks: Vec<(A, FloatNetwork)>,
}

impl<A: Architecture> Teacher<A> {
    /// Of trained weights, each those of its architecture. `device` is a plain one.
    pub fn new<'w>(networks: impl IntoIterator<Item = (A, &'w Weights)>, device: &Device) -> Self {
        let ready = |(architecture, weights)| (architecture, FloatNetwork::new(weights, device));
        Self { networks: networks.into_iter().map(ready).collect() }
    }

    /// Put the mean of their probabilities of the batch into it; nothing without a network.
    pub fn teach(&self, batch: &mut Sequences) {
        let mut taught: Vec<f32> = Vec::new();
        let share = 1.0 / self.networks.len() as f32;
        for (architecture, network) in &self.networks {
            let said = network.probabilities(architecture, batch);
            taught.resize(said.len(), 0.0);
            for (mean, said) in taught.iter_mut().zip(said) {
                *mean += share * said;
            }
        }
        batch.taught = taught;
    }
}
