//! Integers against float, refusals, and files read back.

use slipsense::net::{Model, Network, SensorFeatures};
use slipsense::params::{CLASSES, OUTPUTS};
use slipsense::sensor::PiezoFrame;
use slipsense_model::evaluate::compare;
use slipsense_model::quantize::quantize;
use slipsense_model::trace::Ranges;
use slipsense_model::tract::{Graphs, TractNetwork};
use slipsense_model::weights::{FIRST_DIMS, Weights, specs};
use slipsense_model::{export, weights};
use slipsense_recording::{Episode, Meta};

use crate::common;

const FRAMES: usize = 100;
const SENSORS: usize = 2;

/// Results of `step` on frames of random input. With `missing`, every third scan and every fourth log-mel frame is not
/// there.
fn run<T>(sensors: usize, missing: bool, mut step: impl FnMut(&[SensorFeatures<'_>]) -> T) -> Vec<T> {
    let (scans, xl_frames) = (common::scans(FRAMES, sensors, 3), common::xl_frames(FRAMES, sensors, 4));
    let frame = |frame: usize| {
        let is_there = |sensor: usize, period: usize| !missing || !(frame + sensor).is_multiple_of(period);
        let sensor = |s: usize| SensorFeatures {
            piezo: is_there(s, 3).then(|| &scans[frame * sensors + s]),
            xl: is_there(s, 4).then(|| xl_frames[frame * sensors + s]),
        };
        step(&(0..sensors).map(sensor).collect::<Vec<_>>())
    };
    (0..FRAMES).map(frame).collect()
}

/// Float logits of random input, and the ranges seen on the way.
pub fn run_float(weights: &Weights, sensors: usize, missing: bool) -> (Vec<[f32; OUTPUTS]>, Ranges) {
    let mut network = TractNetwork::new(&Graphs::traced(weights).unwrap(), sensors).unwrap();
    let logits = run(sensors, missing, |seen| network.step(seen).unwrap());
    (logits, Ranges::of(&network.trace))
}

fn run_integer(bytes: &[u8], missing: bool) -> Vec<[f32; OUTPUTS]> {
    let mut network = Network::new(Model::parse(bytes).unwrap());
    run(SENSORS, missing, |seen| network.step(seen).map(|logit| logit.to_f64() as f32))
}

#[test]
fn the_integer_network_follows_the_float_one() {
    let mut of_whole_db = Vec::new();
    for (seed, missing) in [(1, false), (2, false), (3, false), (3, true)] {
        let weights = common::random_weights(seed);
        let (float, ranges) = run_float(&weights, SENSORS, missing);
        let file = quantize(&weights, &ranges, "{}").unwrap();
        let integer = run_integer(&export::to_bytes(&file).unwrap(), missing);
        let snr_db = common::snr_db(&float, &integer);
        println!("seed {seed}, parts missing {missing}: logits {snr_db:.1} dB over the quantization error");
        // Random networks: 46 to 56 dB. Far better would mean that float was compared with itself.
        assert!((45.0..90.0).contains(&snr_db), "seed {seed}, parts missing {missing}: {snr_db} dB");
        of_whole_db.extend((!missing).then_some(snr_db));
    }
    let mean_db = of_whole_db.iter().sum::<f64>() / of_whole_db.len() as f64;
    assert!(mean_db >= 50.0, "{mean_db} dB");
}

#[test]
fn log_odds_that_the_integers_lack_are_not_compared() {
    let mut weights = common::random_weights(7);
    let (_, ranges) = run_float(&weights, 1, false);
    let bytes = export::to_bytes(&quantize(&weights, &ranges, "{}").unwrap()).unwrap();
    common::tensor_mut(&mut weights, "head", "bias")[CLASSES] = 1e6;
    let untouched = Episode {
        sensors: 1,
        piezo: vec![PiezoFrame::zeroed(); 3],
        xl: vec![vec![[0; 3]; 99]],
        xl_end: vec![33, 66, 99],
        label: Some(vec![0; 3]),
        meta: Meta::nominal(1e-3),
        ..Episode::default()
    };
    let graphs = Graphs::new(&weights).unwrap();
    let [power, _] = compare(Model::parse(&bytes).unwrap(), &graphs, &untouched).unwrap().logit_power;
    assert!(power < 1e9, "{power}: without the log-odds");
}

#[test]
fn a_file_says_what_the_quantizer_meant() {
    let weights = common::random_weights(5);
    let (_, ranges) = run_float(&weights, SENSORS, false);
    let file = quantize(&weights, &ranges, "{\"who\":\"test\"}").unwrap();
    let bytes = export::to_bytes(&file).unwrap();
    let model = Model::parse(&bytes).unwrap();
    assert_eq!((model.dims, model.provenance), (FIRST_DIMS, "{\"who\":\"test\"}"));
    let conv3 = model.conv[2];
    for (index, &weight) in file.tensor("piezo.conv3", "weight").iter().enumerate() {
        let inputs = conv3.inputs.count();
        assert_eq!(conv3.weight(index / inputs, index % inputs), weight);
    }
    assert_eq!(model.piezo_dense.multiplier, file.tensor("piezo.dense", "multiplier"));
    assert!(bytes.len() < 200_000, "{} bytes", bytes.len());

    // Every channel uses its accumulator to the last percent, or its weights their 16 bits, and an integer times
    // its step is the weight again.
    let real = weights.get("temporal.query", "weight").chunks_exact(64);
    let bounds = model.temporal.query.accumulator_bounds();
    for ((row, real), bound) in file.tensor("temporal.query", "weight").chunks_exact(64).zip(real).zip(bounds)
    {
        let most = row.iter().map(|w| w.abs()).max().unwrap();
        assert!(most == i32::from(i16::MAX) || bound as f64 > 0.99 * f64::from(i32::MAX), "{most}, {bound}");
        // An integer is the weight over the step, rounded: |weight| lies within half a step of |integer| steps, which
        // leaves an interval of steps for every weight, and one step must lie in all of them.
        let (mut least_step, mut largest_step) = (0.0_f64, f64::INFINITY);
        for (int, real) in row.iter().zip(real) {
            let (int, real) = (f64::from(*int), f64::from(*real));
            assert!(int * real >= 0.0, "{int} {real}");
            least_step = least_step.max(real.abs() / (int.abs() + 0.5));
            if int != 0.0 {
                largest_step = largest_step.min(real.abs() / (int.abs() - 0.5));
            }
        }
        assert!(least_step <= largest_step, "no step gives these integers: {least_step} to {largest_step}");
    }
}

#[test]
fn a_channel_of_large_weights_and_offset_gets_steps_with_which_it_cannot_overflow() {
    let mut weights = Weights::init(FIRST_DIMS, 1);
    let (_, ranges) = run_float(&weights, SENSORS, false);
    common::tensor_mut(&mut weights, "piezo.dense", "weight")[3 * 512..4 * 512].fill(1.0);
    common::tensor_mut(&mut weights, "piezo.dense", "bias")[3] = 1e4;
    let bytes = export::to_bytes(&quantize(&weights, &ranges, "{}").unwrap()).unwrap();
    let dense = Model::parse(&bytes).unwrap().piezo_dense;
    let bound = dense.accumulator_bounds().nth(3).unwrap();
    assert!((0.99..=1.0).contains(&(bound as f64 / f64::from(i32::MAX))), "{bound}");
    // The offset is still many weights' worth.
    assert!(dense.bias[3] > 1_000 * dense.weight(3, 0), "{}", dense.bias[3]);
}

#[test]
fn what_does_not_fit_the_integers_is_refused_by_name() {
    let (_, ranges) = run_float(&common::random_weights(6), SENSORS, false);
    let width = FIRST_DIMS.xl_channels;
    for (layer, part, numbers, value, said) in [
        // Much larger than when the ranges were measured: a ratio of a half or more.
        ("xl.mix1", "weight", 2 * width..3 * width, 1e4, "xl.mix1 multiplier channel 2: ratio"),
        // Beyond 16 bits.
        ("cross_xl.score", "bias", 61..62, -40.0, "cross_xl.score bias 61 is -"),
    ] {
        let mut weights = common::random_weights(6);
        common::tensor_mut(&mut weights, layer, part)[numbers].fill(value);
        let error = quantize(&weights, &ranges, "{}").unwrap_err().to_string();
        assert!(error.starts_with(said), "{error}");
    }
}

#[test]
fn queries_and_keys_have_less_room_where_the_scores_leave_less() {
    // Queries larger than those of a file with a known multiplier, by this factor.
    let random = common::random_weights(6);
    let (_, ranges) = run_float(&random, SENSORS, false);
    let file = quantize(&random, &ranges, "{}").unwrap();
    let of_half = f64::from(file.tensor("cross_piezo.score", "multiplier")[0]) / f64::from(i32::MAX);
    let larger = |times: f64| {
        let mut weights = random.clone();
        for part in ["weight", "bias"] {
            let query = common::tensor_mut(&mut weights, "cross_piezo.query", part);
            query.iter_mut().for_each(|x| *x *= times as f32);
        }
        let (float, ranges) = run_float(&weights, SENSORS, false);
        quantize(&weights, &ranges, "{}").map(|file| (file, float))
    };
    // Twice what the multiplier takes: a factor 1.4 each of the 2 that they have.
    let (file, float) = larger(2.0 / of_half).unwrap();
    assert_eq!(file.tensor("cross_piezo.score", "multiplier"), [i32::MAX]);
    let integer = run_integer(&export::to_bytes(&file).unwrap(), false);
    let snr_db = common::snr_db(&float, &integer);
    println!("logits {snr_db:.1} dB over the quantization error");
    assert!((50.0..90.0).contains(&snr_db), "{snr_db} dB");
    // Twenty times: even half of what was seen does not fit.
    let error = larger(20.0 / of_half).unwrap_err().to_string();
    assert!(error.starts_with("cross_piezo.score multiplier channel 0: ratio"), "{error}");
}

#[test]
fn weights_files_are_read_back_or_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("w.safetensors");
    let weights = common::random_weights(9);
    weights.write(&path).unwrap();
    assert_eq!(Weights::read(&path).unwrap(), weights);
    assert_eq!(weights.to_bytes().unwrap(), weights.to_bytes().unwrap());

    let mut broken = weights.clone();
    broken.tensors[2][1] = f32::NAN;
    let name = weights::name(&specs(&FIRST_DIMS)[2]);
    let error = Weights::from_bytes(&broken.to_bytes().unwrap()).unwrap_err().to_string();
    assert_eq!(error, format!("tensor {name} index 1 is NaN: must be finite"));

    let bytes = weights.to_bytes().unwrap();
    assert!(Weights::from_bytes(&bytes[..bytes.len() / 2]).is_err());
    let missing = Weights::read(&folder.path().join("none")).unwrap_err().to_string();
    assert!(missing.starts_with("cannot read") && missing.ends_with("none"), "{missing}");
    let unwritable = weights.write(&folder.path().join("no/such/w")).unwrap_err().to_string();
    assert!(unwritable.starts_with("cannot write"), "{unwritable}");
}
