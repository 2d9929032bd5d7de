//! Models without training, for tests of the kernels: they decide nothing, but every layer carries
//! signal at the full width of its activations.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::net::format::{Dims, Kind};
use slipsense::net::packing::Inputs;

use super::ModelFile;

/// Largest offset of a channel.
const BIAS_MAX: i32 = 1_000_000;

/// The largest weight with which a channel cannot overflow its accumulator; of a convolution three of them add up in
/// a number of the file.
fn weight_max(inputs: Inputs) -> i32 {
    let most = i64::from(inputs.gain()) * i64::from(inputs.magnitude());
    let sum = (i64::from(i32::MAX) - i64::from(BIAS_MAX)) / most;
    (sum / inputs.count() as i64).min(i64::from(i16::MAX) / 3) as i32
}

/// A model with random tensors that [`slipsense::net::Model::parse`] accepts.
pub fn random_model(dims: Dims, seed: u64) -> ModelFile {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut file = ModelFile::new(dims, "{\"random\":true}");
    for spec in file.specs() {
        let inputs = file.specs().iter().find_map(|s| match s.kind {
            Kind::Weights(inputs) if s.layer == spec.layer => Some(inputs),
            _ => None,
        });
        let tensor = file.tensor_mut(spec.layer, spec.part);
        for value in tensor.iter_mut() {
            *value = match (spec.part, inputs) {
                ("weight", Some(inputs)) => {
                    let most = weight_max(inputs);
                    rng.random_range(-most..=most)
                }
                ("bias", Some(_)) => rng.random_range(-BIAS_MAX..=BIAS_MAX),
                // A typical sum of n products is √n · w/√3 · x: scale it to the size of x again.
                ("multiplier", Some(inputs)) => {
                    let product = f64::from(inputs.gain()) * f64::from(weight_max(inputs)) / 3f64.sqrt();
                    let ratio = 1.0 / ((inputs.count() as f64).sqrt() * product);
                    (ratio * 4_294_967_296.0 * rng.random_range(0.5..1.5)) as i32
                }
                ("multiplier", None) if spec.layer.ends_with("score") => {
                    rng.random_range(100_000..=2_000_000)
                }
                ("multiplier", None) => rng.random_range(100_000..=500_000),
                ("bias", None) => rng.random_range(-4096..=4096),
                // A factor of 2 to 64: the largest sums are cut.
                ("residual", _) => rng.random_range(1 << 17..=1 << 22),
                ("gamma", _) => rng.random_range(8_000..=32_767),
                ("beta", _) => rng.random_range(-10_000_000..=10_000_000),
                _ => rng.random_range(1..=1_000),
            };
        }
    }
    file
}
