//! The two commands from end to end, on a handful of episodes: they make what they say, and a finished
//! run that is resumed writes the same again.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use slipsense::net::Model;
use slipsense::params::CLASSES;
use slipsense_model::data::recipes;
use slipsense_model::folder::{ObjectUses, Use};
use slipsense_model::weights::{Weights, dims_of_size};
use slipsense_model::{MineArgs, QuantizeArgs, TrainArgs, mining, run_mine, run_quantize, run_train};
use slipsense_synth::{ObjectChoice, Shard};

use crate::common;

fn train_args(out: &Path) -> TrainArgs {
    let few = "--episodes 4 --epochs 1 --batch 30 --frames 48 --learning-rate 1e-3";
    common::args(&format!("--out {} {few}", out.display()))
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn train_resume_and_quantize() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let args = train_args(&out);
    run_train(&args).unwrap();
    let weights = out.join("weights.safetensors");
    let first = fs::read(&weights).unwrap();
    assert_eq!(fs::read_to_string(out.join("curves.csv")).unwrap().lines().count(), 2);

    // All epochs are done: resuming writes the same result again, here from a checkpoint not yet put in its place.
    fs::remove_file(&weights).unwrap();
    fs::rename(out.join("checkpoint"), out.join("checkpoint.new")).unwrap();
    run_train(&TrainArgs { resume: true, ..args.clone() }).unwrap();
    assert_eq!(fs::read(&weights).unwrap(), first);
    let other = run_train(&TrainArgs { resume: true, batch: 29, ..args }).unwrap_err();
    assert!(format!("{other:#}").contains("the run was started with"), "{other:#}");

    let at = folder.path().display();
    let files = format!("--weights {at}/run/weights.safetensors --out {at}/m.slipnet --report {at}/r.json");
    let quantize: QuantizeArgs = common::args(&format!("{files} --calibration-episodes 1 --val-episodes 1"));
    run_quantize(&quantize).unwrap();
    let bytes = fs::read(&quantize.out).unwrap();
    assert!(Model::parse(&bytes).unwrap().provenance.contains("\"synthetic\":true"));
    assert!(
        common::json(&folder.path().join("r.json"))["validation"]["same_class_share"].as_f64().unwrap() > 0.9
    );

    let missing = QuantizeArgs { weights: folder.path().join("none"), ..quantize };
    let error = format!("{:#}", run_quantize(&missing).unwrap_err());
    assert!(error.starts_with("cannot read ") && !error.contains('\n'), "{error}");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn a_larger_network_teaches() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    run_train(&TrainArgs { size: 2, ..train_args(&at("large")) }).unwrap();
    let teacher = vec![at("large").join("weights.safetensors")];
    run_train(&train_args(&at("alone"))).unwrap();
    let taught = TrainArgs { teacher: teacher.clone(), ..train_args(&at("taught")) };
    run_train(&taught).unwrap();
    let weights = |name: &str| Weights::read(&at(name).join("weights.safetensors")).unwrap();
    assert_eq!(weights("large").dims, dims_of_size(2));
    assert_eq!(weights("taught").dims, weights("alone").dims);
    assert_ne!(weights("taught"), weights("alone"), "what the teacher says counts");
    let recipe = |name: &str| common::json(&at(name).join("train.json"))["recipe"].take();
    assert!(recipe("taught")["teacher_sha256"].is_array() && recipe("alone").get("teacher_sha256").is_none());

    // Another teacher, or none, is another run.
    let other = run_train(&TrainArgs { resume: true, teacher: Vec::new(), ..taught.clone() }).unwrap_err();
    assert!(format!("{other:#}").contains("the run was started with"), "{other:#}");
    let none = run_train(&TrainArgs { teacher: vec![at("none")], out: at("x"), ..taught }).unwrap_err();
    assert!(format!("{none:#}").starts_with("cannot read ") && !at("x").exists(), "{none:#}");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn a_run_begins_with_given_weights() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let weights = |name: &str| at(name).join("weights.safetensors");
    run_train(&train_args(&at("first"))).unwrap();
    // Steps of next to nothing: what comes out is what went in, not random weights.
    let again = TrainArgs {
        start: Some(weights("first")),
        learning_rate: 1e-9,
        seed: 7,
        ..train_args(&at("second"))
    };
    run_train(&again).unwrap();
    let [first, second] = ["first", "second"].map(|name| Weights::read(&weights(name)).unwrap());
    let differences = first.tensors.iter().flatten().zip(second.tensors.iter().flatten());
    assert!(differences.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-5);

    // Other first weights are another run, and weights of another size are refused.
    let other = run_train(&TrainArgs { resume: true, start: None, ..again.clone() }).unwrap_err();
    assert!(format!("{other:#}").contains("the run was started with"), "{other:#}");
    let size = run_train(&TrainArgs { size: 2, out: at("x"), ..again }).unwrap_err();
    assert!(format!("{size:#}").starts_with("--start ") && !at("x").exists(), "{size:#}");
}

#[test]
fn training_and_validation_share_no_object_and_no_seed() {
    let uses = [Use::Train, Use::Validation];
    let all = uses.map(|what| recipes(what, 1, 60).unwrap());
    for (what, recipes) in uses.into_iter().zip(&all) {
        for recipe in recipes {
            let name = match &recipe.object {
                ObjectChoice::Named(name) => name,
                ObjectChoice::Own(object) => object.name.split("-varied-").next().unwrap(),
                other => panic!("{other:?} is drawn, not named"),
            };
            assert_eq!(ObjectUses::default().use_of(name), what, "{name}");
        }
    }
    let [train, validation] =
        all.map(|recipes| recipes.iter().map(|recipe| recipe.seed).collect::<BTreeSet<_>>());
    assert_eq!(train.len(), 60);
    // Every third one is the one before, disturbed instead of pulled.
    assert_eq!(validation.len(), 40);
    assert!(train.is_disjoint(&validation));
    // The validation episodes do not depend on the training seed, and there are no test episodes here.
    assert_eq!(recipes(Use::Validation, 1, 5).unwrap(), recipes(Use::Validation, 2, 5).unwrap());
    assert!(recipes(Use::Test, 1, 5).is_err());
}

#[test]
fn a_folder_without_episodes_or_a_command_without_sense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let empty = folder.path().join("empty");
    fs::create_dir(&empty).unwrap();
    let out = folder.path().join("out");
    let error = |args: TrainArgs| format!("{:#}", run_train(&args).unwrap_err());
    let args = train_args(&out);
    let message = error(TrainArgs { data: Some(empty.clone()), ..args.clone() });
    assert_eq!(message, format!("{}: no .npz file", empty.display()));
    let message = error(TrainArgs { data: Some(folder.path().join("none")), ..args.clone() });
    assert!(message.starts_with("cannot read ") && message.contains("none"), "{message}");
    assert_eq!(error(TrainArgs { epochs: 0, ..args.clone() }), "--epochs must be at least 1");
    let mine: MineArgs = common::args(&format!("none --out {} --hours 556", out.display()));
    let message = format!("{:#}", run_mine(&mine).unwrap_err());
    assert_eq!(message, "--hours must be above 0 and at most 555");
    let blocked = folder.path().join("file");
    fs::write(&blocked, "").unwrap();
    let message = error(TrainArgs { out: blocked.join("x"), ..args });
    assert!(message.starts_with("cannot make the folder"), "{message}");
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn parts_mine_what_one_run_mines() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("mined");
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("weights/slipsense.safetensors");
    // One that takes much for slip.
    let mut weights = Weights::read(&shipped).unwrap();
    common::tensor_mut(&mut weights, "head", "bias")[CLASSES] += 4.0;
    let eager = folder.path().join("eager.safetensors");
    weights.write(&eager).unwrap();
    let args: MineArgs = common::args(&format!("{} --out {} --hours 0.02", eager.display(), out.display()));
    let part = |text| run_mine(&MineArgs { shard: Some(Shard::parse(text).unwrap()), ..args.clone() });
    let error = |error: anyhow::Error| format!("{error:#}");

    part("2/2").unwrap();
    let missing = error(mining::read(&out).unwrap_err());
    assert!(missing.ends_with("00001-of-00004.safetensors is missing"), "{missing}");
    part("1/2").unwrap();
    let bar = indicatif::ProgressBar::hidden();
    let whole = mining::mine(&weights, 1, 0.02, None, &bar).unwrap();
    assert!(!whole.is_empty());
    assert_eq!(mining::read(&out).unwrap(), whole);

    let other = error(run_mine(&MineArgs { seed: 2, ..args }).unwrap_err());
    assert!(other.contains("mine.json: other weights"), "{other}");
    let second = out.join("00002-of-00004.safetensors");
    let bytes = fs::read(&second).unwrap();
    fs::write(&second, &bytes[..bytes.len() - 1]).unwrap();
    let damaged = error(mining::read(&out).unwrap_err());
    assert!(damaged.contains("00002-of-00004") && !damaged.contains('\n'), "{damaged}");
}
