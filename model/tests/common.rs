//! What the tests feed to networks and commands.

use std::path::Path;

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::features::XlFeatures;
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::params::{OUTPUTS, TAXELS};
use slipsense::sensor::PiezoFrame;
use slipsense_model::float::Sequences;
use slipsense_model::output;
use slipsense_model::tract::xl_real;
use slipsense_model::weights::{FIRST_DIMS, Weights, specs};

/// A command's arguments, as on its line after the name.
pub fn args<T: clap::Args>(line: &str) -> T {
    let command = T::augment_args(clap::Command::new("test").no_binary_name(true));
    T::from_arg_matches(&command.try_get_matches_from(line.split_whitespace()).unwrap()).unwrap()
}

pub fn json(path: &Path) -> serde_json::Value {
    output::read_json(path).unwrap().unwrap()
}

/// Random weights with every kind of parameter away from its first value.
pub fn random_weights(seed: u64) -> Weights {
    let mut weights = Weights::init(FIRST_DIMS, seed);
    let mut rng = ChaCha8Rng::seed_from_u64(seed + 1);
    for x in weights.tensors.iter_mut().flatten() {
        *x += rng.random_range(-0.1..0.1f32);
    }
    weights
}

pub fn tensor_mut<'w>(weights: &'w mut Weights, layer: &str, part: &str) -> &'w mut [f32] {
    let index = specs(&weights.dims).iter().position(|spec| spec.layer == layer && spec.part == part);
    &mut weights.tensors[index.unwrap()]
}

/// Power of the float logits over that of the integers' differences from them, dB.
pub fn snr_db(float: &[[f32; OUTPUTS]], integer: &[[f32; OUTPUTS]]) -> f64 {
    let (mut power, mut error) = (0.0, 0.0);
    for (&float, &integer) in float.as_flattened().iter().zip(integer.as_flattened()) {
        power += f64::from(float).powi(2);
        error += (f64::from(float) - f64::from(integer)).powi(2);
    }
    10.0 * (power / error).log10()
}

/// Put what a network sees of one more sequence into a batch; scans and frames of accelerometers are `[frame][sensor]`.
pub fn add_sequence(input: &mut Sequences, scans: &[PiezoFrame], xl_frames: &[XlFeatures]) {
    for sensor in 0..input.sensors {
        let mut pad = PiezoFrontEnd::new();
        for frame in 0..input.frames {
            let at = frame * input.sensors + sensor;
            pad.push(scans[at].counts(), |_, cell| input.piezo.extend(cell));
            input.xl.extend(xl_frames[at].map(xl_real));
        }
    }
}

/// Scans with a patch of pressure that wanders, `[frame][sensor]`.
pub fn scans(frames: usize, sensors: usize, seed: u64) -> Vec<PiezoFrame> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let scan = |index: usize| {
        let mut counts = [0u16; TAXELS];
        let (row, col) = (8 + index / 7 % 12, 10 + index / 11 % 8);
        for r in row..row + 6 {
            for c in col..col + 5 {
                counts[r * 32 + c] = rng.random_range(0..1500);
            }
        }
        PiezoFrame::from_scan(counts)
    };
    (0..frames * sensors).map(scan).collect()
}

/// Frames of accelerometers, Q2.13, `[frame][sensor]`.
pub fn xl_frames(frames: usize, sensors: usize, seed: u64) -> Vec<XlFeatures> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    (0..frames * sensors).map(|_| std::array::from_fn(|_| rng.random_range(-14_000..14_000))).collect()
}
