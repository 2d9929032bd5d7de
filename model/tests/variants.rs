//! The networks that the shipped one is compared with: the base is it, every one learns, integers are near their
//! floats, and a comparison that is begun again does only what is missing.

use std::fs;
use std::path::Path;

use burn::module::{Module, ParamId};
use burn::optim::AdamWConfig;
use burn::tensor::Device;
use slipsense::features::XlFeatures;
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::net::Model;
use slipsense::params::{CLASSES, MEL_BINS, OUTPUTS, TAXELS, XL_FEATURES};
use slipsense_model::batch::{Options, Sampler};
use slipsense_model::data::Features;
use slipsense_model::encoders::{PadEncoder, named};
use slipsense_model::float::{Architecture, FloatNetwork, Sequences};
use slipsense_model::pad_view::PadView;
use slipsense_model::piezo::IMAGE;
use slipsense_model::target::Target;
use slipsense_model::teacher::Teacher;
use slipsense_model::tract::xl_real;
use slipsense_model::variants::paper::PaperNetwork;
use slipsense_model::variants::results::Finished;
use slipsense_model::variants::{BASE, Making, ROWS, Row, integers, row_named};
use slipsense_model::weights::{FIRST_DIMS, Weights, specs};
use slipsense_model::{ReproduceArgs, run_reproduce};
use slipsense_recording::score::ClassScores;
use slipsense_recording::{Episode, Meta};
use slipsense_synth::Split;

use crate::common;

const SENSORS: usize = 2;

/// One sequence whose classes follow from pads and sound alike.
pub fn sequence(frames: usize, seed: u64) -> Sequences {
    let scans = common::scans(frames, SENSORS, seed);
    let xl_frames = common::xl_frames(frames, SENSORS, seed + 1);
    let mut input = Sequences { batch: 1, sensors: SENSORS, frames, ..Default::default() };
    input.label = (0..frames).map(|t| (t / 20 % CLASSES) as u8).collect();
    input.weight = vec![1.0; frames];
    input.target = vec![Target::Either; frames];
    for sensor in 0..SENSORS {
        let mut pad = PiezoFrontEnd::new();
        for frame in 0..frames {
            let at = frame * SENSORS + sensor;
            let class = input.label[frame];
            let counts = scans[at].counts().map(|count| count * u16::from(class) / 2);
            pad.push(&counts, |_, cell| input.piezo.extend(cell));
            let bins = xl_frames[at].iter().enumerate();
            input.xl.extend(
                bins.map(|(bin, &q)| {
                    xl_real(q) * 0.3 + if bin % CLASSES == class as usize { 1.0 } else { 0.0 }
                }),
            );
        }
    }
    input
}

/// The frames of a sequence from `from` on, features as they are.
fn last_frames(input: &Sequences, from: usize) -> Sequences {
    fn rows<T: Copy>(values: &[T], frames: usize, width: usize, from: usize) -> Vec<T> {
        values.chunks_exact(frames * width).flat_map(|sensor| &sensor[from * width..]).copied().collect()
    }
    Sequences {
        frames: input.frames - from,
        piezo: rows(&input.piezo, input.frames, IMAGE, from),
        xl: rows(&input.xl, input.frames, XL_FEATURES, from),
        label: input.label[from..].to_vec(),
        weight: input.weight[from..].to_vec(),
        target: input.target[from..].to_vec(),
        ..input.clone()
    }
}

fn worst(a: &[[f32; OUTPUTS]], b: &[[f32; OUTPUTS]]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn the_base_is_the_shipped_network() {
    assert_eq!(BASE.specs(), specs(&FIRST_DIMS));
}

#[test]
fn every_network_learns_and_all_its_parameters_do() {
    let device = Device::flex().autodiff();
    let input = sequence(70, 2);
    let ours = |row: &&Row| row.making == Making::Trained && row.encoders.is_none();
    for Row { name, variant, .. } in ROWS.iter().filter(ours) {
        let weights = variant.first_weights(1);
        let mut network = FloatNetwork::new(&weights, &device);
        let mut optimizer = AdamWConfig::new().init();
        let mut losses = Vec::new();
        for _ in 0..12 {
            let (loss, gradients) = network.gradients(variant, &input);
            for (index, spec) in variant.specs().iter().enumerate() {
                let gradient = gradients.get::<1>(ParamId::from(index as u64 + 1));
                assert!(gradient.is_some(), "{name}: {}.{}", spec.layer, spec.part);
            }
            losses.push(loss);
            network = optimizer.step(1e-2, network, gradients);
        }
        println!("{name:20} {} parameters, loss {:.3} to {:.3}", weights.count(), losses[0], losses[11]);
        assert!(losses[11] < 0.7 * losses[0], "{name}: {losses:?}");
    }
}

#[test]
fn the_papers_networks_learn_and_all_their_parameters_do() {
    let device = Device::flex().autodiff();
    let input = sequence(24, 2);
    for Row { name, variant, encoders, .. } in &ROWS {
        let Some(encoders) = *encoders else { continue };
        let mut network = PaperNetwork::new(variant, encoders, 1, &device);
        let is_frozen = encoders.pads == PadEncoder::VitFrozen;
        let count = network.num_params();
        let mut optimizer = AdamWConfig::new().init();
        let mut losses = Vec::new();
        for step in 0..3 {
            let (loss, gradients) = network.gradients(variant, is_frozen, &input, step);
            // Running statistics and what is frozen have none.
            let is_fixed = |part: &str| part.contains("running_") || is_frozen && part.starts_with("pads.");
            let has_gradient = |part: &&String| !is_fixed(part);
            assert_eq!(gradients.len(), named::get(&network).keys().filter(has_gradient).count(), "{name}");
            losses.push(loss);
            network = optimizer.step(1e-3, network, gradients);
        }
        println!("{name:20} {count} parameters, loss {losses:.3?}");
        assert!(losses[2] < 0.95 * losses[0], "{name}: {losses:?}");
        let plain = PaperNetwork::new(variant, encoders, 1, &Device::flex());
        let outputs = named::put(plain, &named::get(&network)).outputs(variant, &input);
        assert!(outputs.len() == 24 && outputs.as_flattened().iter().all(|x| x.is_finite()), "{name}");
    }
}

#[test]
fn several_teachers_say_their_mean() {
    let networks = [1, 2].map(|seed| BASE.first_weights(seed));
    let said = |networks: &[&Weights]| {
        let mut batch = sequence(70, 6);
        Teacher::new(networks.iter().map(|weights| (BASE, *weights)), &Device::flex()).teach(&mut batch);
        batch.taught
    };
    let [one, two] = [&networks[0], &networks[1]].map(|network| said(&[network]));
    let both = said(&[&networks[0], &networks[1]]);
    assert_eq!(both.len(), 70 * CLASSES);
    assert!(one.iter().zip(&two).any(|(a, b)| (a - b).abs() > 1e-3));
    assert!(both.iter().zip(one.iter().zip(&two)).all(|(mean, (a, b))| (mean - (a + b) / 2.0).abs() < 1e-6));
    assert!(said(&[]).is_empty());
}

#[test]
fn a_teacher_counts_half() {
    let device = Device::flex();
    let [pupil, teacher] =
        [BASE, row_named("wide").unwrap().variant].map(|variant| (variant, variant.first_weights(4)));
    assert_eq!((pupil.1.count(), teacher.1.count()), (57_096, 170_844));
    let network = FloatNetwork::new(&pupil.1, &device.clone().autodiff());
    let mut input = sequence(70, 5);
    let mut loss = |taught: Vec<f32>| {
        input.taught = taught;
        network.gradients(&pupil.0, &input).0
    };
    let alone = loss(Vec::new());
    let labels: Vec<f32> = (0..70 * CLASSES)
        .map(|at| f32::from(u8::from(at / CLASSES / 20 % CLASSES == at % CLASSES)))
        .collect();
    assert!((loss(labels.clone()) - alone).abs() < 1e-6, "a teacher that says what the labels say");
    let sure = loss([0.0, 0.0, 1.0].repeat(70));
    let other: Vec<f32> = [0.0, 1.0, 0.0].repeat(70);
    let said = FloatNetwork::new(&teacher.1, &device).probabilities(&teacher.0, &sequence(70, 5));
    for frame in said.as_chunks::<CLASSES>().0 {
        assert!((frame.iter().sum::<f32>() - 1.0).abs() < 1e-5);
    }
    // Cross entropy is linear in what is taught.
    let halves = labels.iter().zip(&other).map(|(label, other)| 0.5 * (label + other)).collect();
    assert!((loss(halves) - 0.5 * (alone + loss(other))).abs() < 1e-5);
    assert!((sure - alone).abs() > 1e-3 && (loss(said) - alone).abs() > 1e-4);
}

#[test]
fn what_is_taken_away_is_not_seen() {
    let logits = |name: &str, input: &Sequences| {
        let variant = row_named(name).unwrap().variant;
        FloatNetwork::new(&variant.first_weights(3), &Device::flex()).outputs(&variant, input)
    };
    let input = sequence(70, 3);
    let deaf = Sequences { xl: vec![0.0; input.xl.len()], ..input.clone() };
    let numb = Sequences { piezo: vec![0; input.piezo.len()], ..input.clone() };
    let mut louder = input.clone();
    for frame in louder.xl.chunks_exact_mut(XL_FEATURES) {
        frame[MEL_BINS..].iter_mut().for_each(|x| *x += 0.5);
    }
    for (name, other, same) in [
        ("piezo", &deaf, true),
        ("piezo", &numb, false),
        ("xl", &numb, true),
        ("xl", &deaf, false),
        ("late", &numb, false),
        ("late", &deaf, false),
        ("no-floor", &louder, true),
        ("base", &louder, false),
    ] {
        assert_eq!(worst(&logits(name, &input), &logits(name, other)) == 0.0, same, "{name}");
    }
    // Only what lies within two windows of 6 and the kernel behind them has an effect on the last frame.
    let whole = logits("t6", &input);
    let short = |from: usize| worst(&whole[69..], &logits("t6", &last_frames(&input, from))[69 - from..]);
    assert!(short(50) < 1e-5 && short(66) > 1e-4, "{} {}", short(50), short(66));
}

#[test]
fn integers_are_near_the_floats_that_they_were_made_of() {
    let weights = common::random_weights(6);
    let episodes = [features(200)];
    let model = integers::model(&weights, &episodes).unwrap();
    let integers = integers::outputs(Model::parse(&model).unwrap(), &episodes[0]);
    let float = FloatNetwork::new(&weights, &Device::flex()).outputs(&BASE, &episodes[0].sequences());
    let db = common::snr_db(&float, &integers);
    println!("integers are {db:.1} dB from the floats");
    assert!(db > 20.0 && integers != float, "{db}");
}

/// One episode of all classes.
fn features(frames: usize) -> Features {
    let label: Vec<u8> = (0..frames).map(|t| (t / 20 % CLASSES) as u8).collect();
    let samples = frames * 33;
    let sample =
        |n: usize| [(n * 7919 % 601) as i16 - 300, (n * 104_729 % 401) as i16 - 200, (n % 97) as i16];
    Features::from_episode(&Episode {
        sensors: SENSORS,
        piezo: common::scans(frames, SENSORS, 8),
        xl: (0..SENSORS).map(|_| (0..samples).map(sample).collect()).collect(),
        xl_end: (0..frames * SENSORS).map(|at| (at / SENSORS + 1) as u32 * 33).collect(),
        label: Some(label),
        meta: Meta::nominal(1e-3),
        ..Episode::default()
    })
    .unwrap()
}

#[test]
fn a_batch_holds_what_its_options_say() {
    let episodes = [features(200)];
    let batch = |options: Options| Sampler::new(&episodes, 60, options).unwrap().batch(8, 5);
    let usual = batch(Options::default());
    let plain = batch(Options { xl_augmentation: false, ..Options::default() });
    assert_eq!(usual.label, plain.label);
    // In float, to the rounding of the integers.
    let near = |seen: &[f32], known: &XlFeatures| {
        seen.iter().zip(known).all(|(seen, &known)| (seen - xl_real(known)).abs() < 2e-3)
    };
    let known = |seen: &[f32]| episodes[0].readings.iter().any(|known| near(seen, &known.xl));
    assert!(plain.xl.chunks_exact(XL_FEATURES).all(known));
    assert!(!usual.xl.chunks_exact(XL_FEATURES).all(known));

    let coarse = batch(Options { pads: PadView { side: 8, change: false }, ..Options::default() });
    for image in coarse.piezo.chunks_exact(IMAGE) {
        assert!(image.iter().skip(1).step_by(2).all(|&change| change == 0));
        let count = |index: usize| image[2 * index];
        assert!((0..TAXELS).all(|at| count(at) == count(at / 128 * 128 + at % 32 / 4 * 4)));
    }
    assert!(coarse.piezo.iter().any(|&count| count > 0));
}

pub fn reproduce_args(out: &Path, rows: &[&str]) -> ReproduceArgs {
    let few = "--seeds 1 --episodes 4 --steps 1 --encoder-steps 1 --test-episodes 1 --encoder-test-episodes 1 \
         --detector-episodes 1";
    let (out, rows) = (out.display(), rows.join(","));
    common::args(&format!("--out {out} --rows {rows} {few} --learning-rate 1e-3 --jobs 2"))
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn a_comparison_goes_on_with_what_is_missing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let read = |name: &str| fs::read_to_string(out.join(name)).unwrap();
    run_reproduce(&reproduce_args(&out, &["integers", "base"])).unwrap();
    let base = read("base-1.json");
    let results = common::json(&out.join("comparisons.json"));
    assert_eq!(results["synthetic"], true);
    assert_eq!(results["rows"][0]["row"], "base");
    assert_eq!(results["rows"][1]["splits"].as_array().unwrap().len(), 6);
    assert!(results["rows"][0]["splits"][1]["macro_f1"]["mean"].is_number());
    assert!(read("comparisons.svg").contains("umi_ood"));

    // These are done: their files, the time it took included, stay.
    let integers = read("integers-1.json");
    run_reproduce(&reproduce_args(&out, &["base", "both", "xl", "integers", "mined", "wide", "distilled"]))
        .unwrap();
    assert_eq!([read("base-1.json"), read("integers-1.json")], [base.clone(), integers]);
    let results = common::json(&out.join("comparisons.json"));
    let rows: Vec<_> = results["rows"].as_array().unwrap().iter().map(|row| &row["row"]).collect();
    assert_eq!(rows, ["base", "both", "xl", "mined", "integers", "wide", "distilled"]);
    assert!(read("report.txt").contains("cannot be told"), "by one seed");
    assert!(read("example.svg").contains("accelerometers"));
    // The picture has the classes that are scored; the detector needs pads.
    for row in ["both", "xl"] {
        let done: Finished = serde_json::from_str(&read(&format!("{row}-1.json"))).unwrap();
        let (example, scored) = (done.example.unwrap(), &done.splits[2]);
        let found = ClassScores::new(&example.label, &example.class).confusion;
        assert_eq!((scored.split, found), (Split::UmiOod, scored.confusion[0]), "{row}");
        assert_eq!(done.detector.is_some(), row == "both");
    }
    // The paper's figures beside ours: of the whole network, and of accelerometers alone.
    let published: Vec<_> = results["published"].as_array().unwrap().iter().collect();
    let beside = |row: &str| published.iter().filter(|pair| pair["row"] == row).collect::<Vec<_>>();
    assert_eq!((beside("base").len(), beside("xl").len(), beside("wide").len()), (5, 2, 0));
    assert_eq!(beside("xl")[1]["paper"]["macro_f1_percent"], 81.33);
    assert_eq!(beside("xl")[1]["ours"]["split"], "umi_ood");
    assert!(read("distilled-1.json") != base && out.join("wide-1.safetensors").exists());

    let error = |args: ReproduceArgs| format!("{:#}", run_reproduce(&args).unwrap_err());
    let message = error(ReproduceArgs { steps: Some(2), ..reproduce_args(&out, &["base"]) });
    assert!(message.contains("base-1.json: budget is"), "{message}");
    assert_eq!(read("base-1.json"), base);

    // Figures alone do not make a row that others can go on from.
    fs::remove_file(out.join("base-1.safetensors")).unwrap();
    fs::remove_file(out.join("integers-1.json")).unwrap();
    let message = error(reproduce_args(&out, &["base", "integers"]));
    assert!(message.contains("base-1.safetensors is missing, which row integers needs: delete"), "{message}");
    assert!(message.ends_with("base-1.json and add base to --rows, to train it again"), "{message}");
    assert_eq!(read("base-1.json"), base);
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn a_row_of_the_papers_is_the_same_after_an_interruption() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let args = |out: &str| reproduce_args(&at(out), &["paper", "paper-cnn"]);
    let splits = |out: &str, row: &str| common::json(&at(out).join(format!("{row}-1.json")))["splits"].take();
    run_reproduce(&args("whole")).unwrap();
    // As an interruption leaves it: encoders pretrained, one row finished.
    fs::create_dir(at("cut")).unwrap();
    for file in ["budget.json", "ssast-1.safetensors", "paper-cnn-1.json"] {
        fs::copy(at("whole").join(file), at("cut").join(file)).unwrap();
    }
    run_reproduce(&args("cut")).unwrap();
    for row in ["paper", "paper-cnn"] {
        assert_eq!(splits("cut", row), splits("whole", row), "{row}");
    }

    // An encoder of another shape, or of another budget, is refused.
    fs::copy(at("cut").join("ssast-1.safetensors"), at("cut").join("vit-mae-1.safetensors")).unwrap();
    let error = |args: &ReproduceArgs| format!("{:#}", run_reproduce(args).unwrap_err());
    let message = error(&reproduce_args(&at("cut"), &["vit-frozen"]));
    assert!(message.contains("vit-mae-1.safetensors: tensor class_token is missing"), "{message}");
    for row in ["paper", "paper-cnn"] {
        fs::remove_file(at("cut").join(format!("{row}-1.json"))).unwrap();
    }
    let message = error(&ReproduceArgs { encoder_steps: Some(2), ..args("cut") });
    assert!(message.contains("budget.json: budget is") && !message.contains('\n'), "{message}");
    let message = error(&ReproduceArgs { ssast: Some(at("cut").join("vit-mae-1.safetensors")), ..args("x") });
    assert!(
        message.contains("tensor v.cls_token is missing: not SSAST-Tiny") && !at("x").exists(),
        "{message}"
    );
}

#[test]
fn a_comparison_without_sense_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let error = |args: ReproduceArgs| format!("{:#}", run_reproduce(&args).unwrap_err());
    assert!(error(reproduce_args(&out, &["bass"])).starts_with("--rows: bass is not a row (base, "));
    let alone = error(reproduce_args(&out, &["integers"]));
    assert!(alone.ends_with("which row integers needs: add base to --rows"), "{alone}");
    let untaught = error(reproduce_args(&out, &["base", "distilled"]));
    assert!(
        untaught.ends_with("wide-1.safetensors is missing, which row distilled needs: add wide to --rows")
    );
    let twice = error(ReproduceArgs { seeds: vec![3, 3], ..reproduce_args(&out, &["base"]) });
    assert_eq!(twice, "--seeds: 3 is there twice");
    let none = error(ReproduceArgs { test_episodes: Some(0), ..reproduce_args(&out, &["base"]) });
    assert_eq!(none, "--test-episodes must be at least 1");
    assert!(!out.exists());
}
