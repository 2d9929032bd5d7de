//! The gradients that the optimizer gets against differences of the loss.

use burn::module::ParamId;
use burn::tensor::Device;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense_model::float::{FloatNetwork, Sequences};
use slipsense_model::piezo::{self, Filters};
use slipsense_model::target::Target;
use slipsense_model::weights::{Weights, name, specs};

use crate::common;

const FRAMES: usize = 21;
const SENSORS: usize = 2;
/// How far a parameter is moved: little, as the loss has kinks where another frame becomes the worst of its stretch.
const STEP: f32 = 1e-3;

fn sequences() -> Sequences {
    let mut input = Sequences { batch: 3, sensors: SENSORS, frames: FRAMES, ..Default::default() };
    for sequence in 0..input.batch as u64 {
        let scans = common::scans(FRAMES, SENSORS, 20 + sequence);
        let xl_frames = common::xl_frames(FRAMES, SENSORS, 30 + sequence);
        common::add_sequence(&mut input, &scans, &xl_frames);
    }
    let frames = input.batch * FRAMES;
    input.label = (0..frames).map(|t| (t / 7 % 3) as u8).collect();
    let targets = [Target::Still, Target::Begins, Target::Slides, Target::Either];
    input.extreme_weight = Some(2.0);
    input.target = (0..frames).map(|t| targets[t / 5 % 4]).collect();
    input.weight = (0..frames).map(|t| [0.0, 1.0, 3.0, 0.3][t % 4]).collect();
    input
}

fn loss(weights: &Weights, input: &Sequences) -> f64 {
    let device = Device::flex().autodiff();
    FloatNetwork::new(weights, &device).gradients(&weights.dims, input).0
}

#[test]
fn gradients_are_the_slopes_of_the_loss() {
    let weights = common::random_weights(3);
    let input = sequences();
    let device = Device::flex().autodiff();
    let (_, gradients) = FloatNetwork::new(&weights, &device).gradients(&weights.dims, &input);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (index, spec) in specs(&weights.dims).iter().enumerate() {
        let gradient = gradients.get::<1>(ParamId::from(index as u64 + 1)).expect("every parameter has one");
        let gradient: Vec<f32> = gradient.into_data().iter::<f32>().collect();
        assert_eq!(gradient.len(), spec.len());
        // Along a random direction: single slopes drown in the rounding of the loss.
        let direction: Vec<f32> = (0..spec.len()).map(|_| rng.random_range(-1.0..1.0f32)).collect();
        let norm = direction.iter().map(|x| x * x).sum::<f32>().sqrt();
        let moved = |by: f32| {
            let mut moved = weights.clone();
            for (x, d) in moved.tensors[index].iter_mut().zip(&direction) {
                *x += by * d / norm;
            }
            loss(&moved, &input)
        };
        let slope = (moved(STEP) - moved(-STEP)) / f64::from(2.0 * STEP);
        let expected: f64 =
            gradient.iter().zip(&direction).map(|(g, d)| f64::from(g * d)).sum::<f64>() / f64::from(norm);
        let largest = gradient.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt();
        println!("{:24} slope {slope:+.5}, gradient {expected:+.5} of {largest:.5}", name(spec));
        assert!((slope - expected).abs() < 2e-3 + 0.03 * largest, "{}: {slope} {expected}", name(spec));
    }
}

#[test]
fn the_convolutions_gradients_do_not_depend_on_the_number_of_threads() {
    let weights = common::random_weights(4);
    let of = |part: &str| piezo::LAYERS.map(|layer| weights.get(layer, part).to_vec());
    let filters = Filters { weight: of("weight"), bias: of("bias") };
    let images = sequences().piezo;
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (features, tape) = piezo::forward(&filters, &images);
            let gradients = piezo::backward(&filters, &images, &tape, &features);
            (features, gradients.weight, gradients.bias)
        })
    };
    let one = with(1);
    assert!(one.1.iter().all(|block| block.iter().any(|&g| g != 0.0)));
    assert!(with(2) == one && with(5) == one);
}
