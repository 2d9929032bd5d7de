//! The trainer on a graphics processor computes what it computes on the CPU, but for roundings. A driver of Vulkan in
//! software will do, such as Mesa's.

use burn::module::Module;
use burn::optim::{AdamWConfig, GradientsParams, SgdConfig};
use burn::tensor::Device;
use serde_json::json;
use slipsense_model::checkpoint::Checkpoint;
use slipsense_model::device::DeviceName;
use slipsense_model::encoders::PadEncoder;
use slipsense_model::encoders::named::{self, Named};
use slipsense_model::float::FloatNetwork;
use slipsense_model::variants::paper::PaperNetwork;
use slipsense_model::variants::{BASE, Making, ROWS, Row};
use slipsense_model::{ReproduceArgs, run_reproduce};

use crate::common;
use crate::variants::{reproduce_args, sequence};

/// Of the loss, and of a parameter's gradient as a share of the largest in its tensor.
const LARGEST_ERROR: f32 = 2e-3;

/// The numbers of a module after one step against the gradients, which shows these.
fn stepped<M: Module + Clone>(module: M, gradients: GradientsParams) -> Named {
    named::get(&SgdConfig::new().init().step(1.0, module, gradients))
}

/// Loss, first numbers, numbers after one step.
fn step(row: &Row, device: &Device) -> (f64, Named, Named) {
    let (variant, input) = (&row.variant, sequence(24, 2));
    if let Some(encoders) = row.encoders {
        let network = PaperNetwork::new(variant, encoders, 1, device);
        let is_frozen = encoders.pads == PadEncoder::VitFrozen;
        // Before the step, in which batch norms take their statistics.
        let first = named::get(&network);
        let (loss, gradients) = network.gradients(variant, is_frozen, &input, 1);
        return (loss, first, stepped(network, gradients));
    }
    let network = FloatNetwork::new(&variant.first_weights(1), device);
    let (loss, gradients) = network.gradients(variant, &input);
    (loss, named::get(&network), stepped(network, gradients))
}

#[test]
#[ignore = "needs a driver of a graphics processor: cargo test --release -p slipsense-model --features gpu gpu -- --ignored"]
fn losses_and_gradients_are_those_of_the_cpu() {
    let [cpu, gpu] = [DeviceName::Cpu, DeviceName::Gpu].map(|name| name.open().unwrap().autodiff());
    for row in ROWS.iter().filter(|row| row.making == Making::Trained) {
        let (loss, first, after) = step(row, &cpu);
        let (loss_on_gpu, first_on_gpu, after_on_gpu) = step(row, &gpu);
        assert!(first == first_on_gpu, "{}: other first numbers", row.name);
        let mut worst = 0f32;
        for (name, numbers) in &first {
            let change = |after: &Named| -> Vec<f32> {
                numbers.values.iter().zip(&after[name].values).map(|(first, after)| first - after).collect()
            };
            let (change, on_gpu) = (change(&after), change(&after_on_gpu));
            let largest = change.iter().fold(1e-3f32, |largest, x| largest.max(x.abs()));
            let error = change.iter().zip(&on_gpu).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(error <= LARGEST_ERROR * largest, "{}: {name} off by {error} of {largest}", row.name);
            worst = worst.max(error / largest);
        }
        println!("{:20} loss {loss:.4} and {loss_on_gpu:.4}, gradients off by {worst:.1e}", row.name);
        assert!((loss - loss_on_gpu).abs() < f64::from(LARGEST_ERROR) * loss, "{}", row.name);
    }
}

#[test]
#[ignore = "needs a driver of a graphics processor, as above"]
fn an_optimizer_that_was_stored_goes_on() {
    let gpu = DeviceName::Gpu.open().unwrap().autodiff();
    let (first, input) = (BASE.first_weights(1), sequence(24, 2));
    let mut optimizer = AdamWConfig::new().init();
    let network = FloatNetwork::new(&first, &gpu);
    let (_, gradients) = network.gradients(&BASE, &input);
    let network = optimizer.step(1e-3, network, gradients);
    let folder = tempfile::tempdir().unwrap();
    let stored = Checkpoint { weights: first.clone(), average: first, rows: Vec::new(), recipe: json!({}) };
    stored.write(folder.path(), &optimizer).unwrap();
    let (_, mut restored) =
        Checkpoint::read(folder.path(), &stored.recipe, AdamWConfig::new().init()).unwrap();
    let [kept, restored] = [&mut optimizer, &mut restored].map(|optimizer| {
        let (_, gradients) = network.gradients(&BASE, &input);
        optimizer.step(1e-3, network.clone(), gradients).weights(BASE.dims()).tensors
    });
    assert!(kept == restored);
}

#[test]
#[ignore = "needs a driver of a graphics processor, as above"]
fn a_comparison_says_what_made_each_row() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    run_reproduce(&reproduce_args(&out, &["base"])).unwrap();
    run_reproduce(&ReproduceArgs { device: DeviceName::Gpu, ..reproduce_args(&out, &["base", "paper-cnn"]) })
        .unwrap();
    let results = common::json(&out.join("comparisons.json"));
    assert_eq!([0, 1].map(|row| &results["rows"][row]["devices"]), [&json!(["cpu"]), &json!(["gpu"])]);
}
