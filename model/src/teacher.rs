//! A trained network that another one learns from: what it says of a batch counts beside the labels
//! ([`Sequences::taught`]).

use burn::tensor::Device;

use crate::float::{Architecture, FloatNetwork, Sequences};
use crate::weights::Weights;

/// The teacher, ready to be asked.
#[derive(Debug)]
pub struct Teacher<A> {
    architecture: A,
    network: FloatNetwork,
    device: Device,
}

impl<A: Architecture> Teacher<A> {
    /// Of trained weights, which are those of `architecture`.
    pub fn new(architecture: A, weights: &Weights) -> Self {
        let device = Device::flex();
        Self { architecture, network: FloatNetwork::fixed(weights, &device), device }
    }

    /// Put what it says of the batch, as it was drawn, into the batch.
    pub fn teach(&self, batch: &mut Sequences) {
        batch.taught = self.network.probabilities(&self.architecture, batch, &self.device);
    }
}
