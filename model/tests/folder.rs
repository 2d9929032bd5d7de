//! Training on a folder of labelled episodes: what is for what, and what is refused before anything is read.

use std::fs;
use std::path::Path;

use slipsense::sensor::PiezoFrame;
use slipsense_model::data::recipes;
use slipsense_model::folder::{LabelledFolder, ObjectUses, Use};
use slipsense_model::{TrainArgs, run_quantize, run_train};
use slipsense_recording::{Episode, Meta};

use crate::common;

fn train_args(out: &Path, data: &Path, more: &str) -> TrainArgs {
    let (out, data) = (out.display(), data.display());
    common::args(&format!("--out {out} --data {data} --epochs 1 --batch 30 --frames 48 {more}"))
}

/// A short episode of an object with these labels, one value per frame.
fn write_episode(path: &Path, object: Option<&str>, label: Option<&[u8]>, sensors: usize, frames: usize) {
    let mut meta = Meta::nominal(0.000_488);
    if let Some(object) = object {
        meta.other.insert("object".to_owned(), object.into());
    }
    let episode = Episode {
        sensors,
        piezo: vec![PiezoFrame::zeroed(); frames * sensors],
        xl: vec![vec![[0; 3]; frames * 34]; sensors],
        xl_end: (0..frames * sensors).map(|i| ((i / sensors + 1) * 100 / 3) as u32).collect(),
        label: label.map(|label| (0..frames).map(|f| label[f * label.len() / frames]).collect()),
        meta,
        ..Episode::default()
    };
    episode.write(path).unwrap();
}

#[test]
fn what_a_folder_of_recordings_lacks_is_said_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    fs::create_dir(&data).unwrap();
    let out = folder.path().join("out");
    let args = train_args(&out, &data, "");
    let error = |args: &TrainArgs| format!("{:#}", run_train(args).unwrap_err());
    let refused = |args: &TrainArgs, place: &Path, said: &str| {
        let error = error(args);
        assert!(error.starts_with(&format!("{}: {said}", place.display())), "{error}");
    };
    let (a, b) = (data.join("a.npz"), data.join("b.npz"));
    let all = Some(&[0, 1, 2][..]);

    write_episode(&a, None, all, 1, 90);
    refused(&args, &a, "`meta` has no \"object\"");
    write_episode(&a, Some("mug"), None, 1, 90);
    refused(&args, &a, "array `label` is missing");
    write_episode(&a, Some("mug"), all, 1, 90);
    let use_of = |name| ObjectUses::default().use_of(name);
    assert_eq!((use_of("mug"), use_of("rod")), (Use::Train, Use::Train), "the names of this test");
    let said = "no object is for validation (train: mug × 1; validation: none; test: none)";
    refused(&args, &data, said);
    assert!(error(&args).contains("--validation OBJECT"));
    let with = |validation: &str| TrainArgs { validation: vec![validation.to_owned()], ..args.clone() };
    refused(&with("cup"), &data, "no episode of the object \"cup\"");
    refused(&with("mug"), &data, "no object is for training");
    write_episode(&b, Some("rod"), all, 2, 90);
    let message = error(&with("rod"));
    assert!(message.contains("has 2 sensors") && message.contains("a.npz has 1"), "{message}");
    assert!(!out.exists(), "nothing is left of what could not begin");
    write_episode(&b, Some("rod"), all, 1, 90);
    let short = TrainArgs { frames: 91, ..with("rod") };
    assert_eq!(
        error(&short),
        format!("{}: 90 frames are fewer than a training sequence has: --frames is 91", a.display())
    );
    write_episode(&a, Some("mug"), Some(&[0, 1]), 1, 90);
    assert!(error(&with("rod")).contains("no training frame has label 2"), "{}", error(&with("rod")));
}

#[test]
fn a_person_says_which_objects_are_for_what() {
    let uses = ObjectUses { validation: vec!["mug".into()], test: vec!["rod".into()] };
    for (object, what) in [("mug", Use::Validation), ("rod", Use::Test), ("tape", Use::Train)] {
        assert_eq!(uses.use_of(object), what, "{object}");
    }
    // Test objects of the catalogue are never trained on, whatever else is named.
    for object in slipsense_synth::objects::of_group(slipsense_synth::objects::Group::HeldOut) {
        assert_eq!(uses.use_of(&object.name), Use::Test);
    }
}

#[test]
fn of_too_many_files_those_read_are_of_all_objects() {
    let folder = tempfile::tempdir().unwrap();
    let objects = ["mug", "rod", "tape"];
    for index in 0..12 {
        let path = folder.path().join(format!("{index:02}.npz"));
        write_episode(&path, Some(objects[index / 4]), Some(&[0]), 1, 1);
    }
    let uses = ObjectUses { validation: objects.map(str::to_owned).into(), test: Vec::new() };
    let data = LabelledFolder { path: folder.path().to_owned(), uses };
    for (most, names, objects, is_part) in [
        (2, "00 06", "mug rod", true),
        (3, "00 04 08", "mug rod tape", true),
        (5, "00 02 04 07 09", "mug rod tape", true),
        (12, "00 01 02 03 04 05 06 07 08 09 10 11", "mug rod tape", false),
        (99, "00 01 02 03 04 05 06 07 08 09 10 11", "mug rod tape", false),
    ] {
        let chosen = data.choose(Use::Validation, most).unwrap();
        let read: Vec<_> =
            chosen.files.iter().map(|path| path.file_stem().unwrap().to_str().unwrap()).collect();
        assert_eq!(
            (read.join(" "), Vec::from_iter(chosen.objects).join(" ")),
            (names.into(), objects.into())
        );
        let said = format!("{}: {most} of 12 validation episodes", folder.path().display());
        assert_eq!(chosen.left_out, is_part.then_some(said));
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "takes minutes without optimisation; run with --release")]
fn a_folder_of_labelled_episodes_trains_and_quantizes() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    fs::create_dir(&data).unwrap();
    for (index, recipe) in recipes(Use::Train, 7, 3).unwrap().iter().enumerate() {
        let mut episode = slipsense_synth::generate(recipe).unwrap();
        episode.meta.other.insert("object".to_owned(), format!("mine-{index}").into());
        episode.write(data.join(format!("{index}.npz"))).unwrap();
    }
    let out = folder.path().join("run");
    let args = train_args(&out, &data, "--validation mine-1 --test mine-2");
    run_train(&args).unwrap();
    let manifest = common::json(&out.join("train.json"));
    assert_eq!(manifest["validation_objects"], serde_json::json!(["mine-1"]));
    assert_eq!((&manifest["train_episodes"], &manifest["validation_episodes"]), (&1.into(), &1.into()));

    // The quantizer keeps to the same objects.
    let at = folder.path().display();
    let files = format!("--weights {at}/run/weights.safetensors --out {at}/m.slipnet --report {at}/r.json");
    run_quantize(&common::args(&format!("{files} --data {at}/data"))).unwrap();
    let report = common::json(&folder.path().join("r.json"));
    assert_eq!((&report["calibration_episodes"], &report["validation"]["episodes"]), (&1.into(), &1.into()));
}
