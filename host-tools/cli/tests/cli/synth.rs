//! Sets of synthetic episodes: the same however they are made, refused where they do not fit, and never
//! half there.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::thread::sleep;
use std::time::Duration;

use crate::support::{Place, names, unlabelled_episode};
use serde_json::Value;
use slipsense_recording::Episode;
use slipsense_synth::Split;
use slipsense_synth::splits::{EpisodeSet, SetHashes, content_hash};

/// Everything in a folder, hidden files too.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let file = |name: String| fs::read(folder.join(&name)).map(|bytes| (name, bytes));
    names(folder).into_iter().map(|name| file(name).expect("files only")).collect()
}

const SET: &str = "--split train --frames 5000 --seed 3";

#[test]
fn a_set_is_what_split_seed_and_frames_say() {
    let place = Place::new();
    let out = place.path("deep/set");
    let summary = place.json(&format!("synth {SET} --out @deep/set"));
    let set = EpisodeSet::new(Split::Train, 3, 5000);
    assert_eq!(EpisodeSet::parse(&fs::read_to_string(out.join("set.json")).unwrap()).unwrap(), set);
    let hashes = fs::read_to_string(out.join("hashes.json")).unwrap();
    let hashes = SetHashes::parse(&hashes, &set).unwrap();
    assert_eq!(names(&out).len(), set.episodes.len() + 2);
    for (planned, stored) in set.episodes.iter().zip(&hashes.episodes) {
        let episode = Episode::read(out.join(format!("{}.npz", planned.name))).unwrap();
        assert_eq!(episode.frames(), planned.frames);
        assert_eq!(content_hash(&episode), stored.hash, "as read from disk");
    }
    let of = |key: &str| &summary["sets"][0][key];
    assert_eq!((of("split"), of("hash")), (&"train".into(), &hashes.set.clone().into()));
    assert_eq!((of("complete"), of("frozen")), (&true.into(), &false.into()));
    assert_eq!(of("frames"), set.total_frames());
    assert!(summary["x_real_time"].as_f64().is_some_and(|times| times > 0.0));

    // The recipe that an episode carries makes it again.
    let episode = Episode::read(out.join("train-00001.npz")).unwrap();
    place.file("r.json", episode.meta.other["recipe"].to_string());
    place.run("synth --recipe @r.json --out @again.npz");
    assert_eq!(fs::read(place.path("again.npz")).unwrap(), fs::read(out.join("train-00001.npz")).unwrap());
}

#[test]
fn shards_and_interrupted_runs_make_the_same_bytes() {
    let place = Place::new();
    let whole = place.path("whole");
    place.run(&format!("synth {SET} --out @whole"));
    let expected = content(&whole);

    let parts = place.path("parts");
    for (shard, done) in [("2/3", false), ("3/3", false), ("1/3", true)] {
        let text = place.run(&format!("synth {SET} --shard {shard} --out @parts"));
        assert_eq!(text.contains("hash "), done, "{text}");
        assert_eq!(parts.join("hashes.json").exists(), done);
        assert_eq!(fs::read(parts.join("set.json")).unwrap(), expected["set.json"]);
    }
    assert!(content(&parts) == expected, "shards make the same files");

    // Killed as soon as the first episode is there; then the power fails while a file is copied.
    let cut = place.path("cut");
    let make_cut = format!("synth {SET} --out @cut");
    let mut run = place.start(&make_cut);
    let episodes = || match cut.exists() {
        true => names(&cut).into_iter().filter(|name| name.ends_with(".npz")).collect(),
        false => Vec::new(),
    };
    while episodes().is_empty() {
        assert!(run.try_wait().unwrap().is_none(), "ended before it was killed");
        sleep(Duration::from_millis(2));
    }
    run.kill().unwrap();
    run.wait().unwrap();
    let there = episodes();
    println!("killed with {there:?} of {} files there", expected.len() - 2);
    assert!(there.iter().all(|name| fs::read(cut.join(name)).unwrap() == expected[name]), "whole or absent");
    let first = cut.join(&there[0]);
    fs::write(&first, &expected[&there[0]][..10_000]).unwrap();
    fs::write(cut.join(".slipsense-x.partial"), "half").unwrap();
    place.run(&make_cut);
    assert!(content(&cut) == expected, "the resumed run makes the same files, and nothing else is left");

    let again = place.run(&make_cut);
    assert!(again.contains("nothing was missing"), "{again}");
    assert!(content(&cut) == expected);
}

#[test]
fn what_does_not_fit_a_folder_is_refused_and_nothing_touched() {
    let place = Place::new();
    let out = place.path("set");
    place.run("synth --split val --frames 1 --out @set");
    let good = content(&out);
    let refused = |set: &str, file: &str, rule: &str| {
        let before = content(&out);
        let line = format!("synth {set} --out @set");
        place.errors([(&line, format!("@set/{file} … {rule}"))]);
        assert!(content(&out) == before, "{rule}: nothing is touched");
    };
    let same = "--split val --frames 1";
    refused("--split val --frames 1 --seed 9", "set.json", "`seed` is 0, not 9");
    refused("--split palm --frames 1", "set.json", "`split` is val, not palm");
    refused("--split val --frames 2", "set.json", "`frames` is 1, not 2");

    let text = String::from_utf8(good["set.json"].clone()).unwrap();
    let hashes = String::from_utf8(good["hashes.json"].clone()).unwrap();
    for (file, damaged, rule) in [
        ("set.json", text[..40].to_owned(), "is damaged"),
        ("set.json", text.replace("\"seed\":0,", ""), "missing field `seed`"),
        ("set.json", text.replace("\"noise\":1.0", "\"noise\":0.5"), "`recipe of val-00000` is another"),
        ("set.json", text.replace("\"generator\":", "\"generator\":99"), "`generator` is 99"),
        ("set.json", text.replace("val-00000", "val-00007"), "`episodes[0].name` is \"val-00007\""),
        ("hashes.json", hashes[..80].to_owned(), "is damaged"),
        ("hashes.json", hashes.replace("\"hash\":\"", "\"hash\":\"0"), "`set` is not the hash"),
        ("hashes.json", hashes.replace("\"val\"", "\"palm\""), "`split` is palm"),
    ] {
        fs::write(out.join(file), damaged).unwrap();
        refused(same, file, rule);
        // Other recipes or another generator's set are not damaged in themselves.
        if !rule.contains("recipe of") && !rule.contains("generator") {
            refused("--verify", file, rule);
        }
        fs::write(out.join(file), &good[file]).unwrap();
    }
    fs::write(out.join("set.json"), [0xff, 0xfe]).unwrap();
    refused(same, "set.json", "cannot read");
    fs::remove_file(out.join("set.json")).unwrap();
    refused(same, "val-00000.npz", "no set.json");
    fs::write(out.join("set.json"), &text).unwrap();
    assert!(place.run(&format!("synth {same} --out @set")).contains("nothing was missing"));
}

#[test]
fn verify_names_the_first_file_that_differs() {
    let place = Place::new();
    let out = place.path("set");
    let set = "synth --split val --frames 3500 --seed 8 --out @set";
    place.run(set);
    let good = content(&out);
    let verify = "synth --verify --out @set";
    assert!(place.run(verify).contains("every episode is as hashes.json says"));
    let (file, other) = (out.join("val-00001.npz"), out.join("val-00000.npz"));
    let refused = |rule: &str, shown: &Path| {
        for line in [verify, &format!("{set} --verify")] {
            let error = place.error(line);
            assert!(error.starts_with(&shown.display().to_string()) && error.contains(rule), "{error}");
        }
    };
    let mut episode = Episode::read(&file).unwrap();
    episode.slip_true_mm_s.as_mut().unwrap()[100] += 0.5;
    episode.write(&file).unwrap();
    refused("differs from what hashes.json says", &file);

    fs::copy(&other, place.path("other")).unwrap();
    episode.meta.other["recipe"]["seed"] = 5.into();
    episode.write(&file).unwrap();
    refused("was not made by the recipe", &file);

    fs::write(&file, &good["val-00001.npz"]).unwrap();
    fs::copy(&other, out.join("mine.npz")).unwrap();
    refused("is not in set.json", &out.join("mine.npz"));
    fs::remove_file(out.join("mine.npz")).unwrap();

    fs::remove_file(&file).unwrap();
    place.errors([(verify, "val-00001.npz: is missing")]);
    // What is missing is made anew, and is what it was.
    place.run(&format!("{set} --verify"));
    assert!(content(&out) == good);

    fs::remove_file(out.join("hashes.json")).unwrap();
    place.errors([(verify, "hashes.json: is missing"), ("synth --verify --out @none", "holds no set")]);
    place.run(set);
    assert!(content(&out) == good, "hashes of files from earlier runs");
}

#[test]
fn all_splits_in_folders() {
    let place = Place::new();
    let out = place.path("data");
    let summary = place.json("synth --all --frames 11000 --out @data");
    let mut folders = Split::PAPER.map(|split| split.name().to_owned());
    folders.sort();
    assert_eq!(names(&out), folders);
    assert_eq!(summary["sets"].as_array().unwrap().len(), folders.len());
    for split in Split::PAPER {
        let files = names(&out.join(split.name()));
        assert!(files.contains(&format!("{split}-00000.npz")), "{files:?}");
        assert!(files.contains(&"hashes.json".to_owned()), "{files:?}");
    }
    let verified = place.run("synth --verify --out @data");
    assert!(verified.lines().count() == folders.len() + 1, "{verified}");
    place.errors([("synth --all --frames 11000 --seed 1 --out @data", "train/set.json: `seed` is 0, not 1")]);
}

#[test]
fn options_that_make_no_sense() {
    let place = Place::new();
    let file = place.file("file", "mine");
    let cases = [
        ("--split umi", "invalid value 'umi' for '--split"),
        ("--split val --frames 0", "invalid value '0' for '--frames"),
        ("--split val --frames many", "invalid value 'many' for '--frames"),
        ("--split val --frames=-5", "invalid value '-5' for '--frames"),
        ("--split val --seed 1.5", "invalid value '1.5' for '--seed"),
        ("--split val --shard 0/3", "must be from 1/3 to 3/3"),
        ("--split val --shard 4/3", "must be from 1/3 to 3/3"),
        ("--split val --shard 1/0", "must be I/N"),
        ("--split val --shard half", "must be I/N"),
        ("--split val --all", "cannot be used with"),
        ("--split val --recipe r.json", "cannot be used with"),
        ("--verify --frames 5", "required"),
        ("", "--split"),
        ("--split train", "--frames: "),
    ];
    place.errors(cases.map(|(set, rule)| (format!("synth {set} --out @out"), rule)));
    let sets = ["--split val --frames 1", "--all --frames 1", "--verify"];
    place.errors(sets.map(|set| (format!("synth {set} --out @file"), "@file: ")));
    assert_eq!(fs::read(&file).unwrap(), b"mine");
}

/// A disk that is full, played by a limit on the size of files. What is described stays, to go on from.
#[test]
#[cfg(target_os = "linux")]
fn a_full_disk_leaves_no_half_episode() {
    let place = Place::new();
    let out = place.path("out");
    let output =
        place.start_limited(64, "synth --split val --frames 1 --out @out").wait_with_output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(2), "{error}");
    let file = out.join("val-00000.npz").display().to_string();
    assert!(
        error.starts_with(&format!("error: {file}: cannot write")) && error.lines().count() == 1,
        "{error:?}"
    );
    assert_eq!(names(&out), ["set.json"]);
    place.run("synth --split val --frames 1 --out @out");
    assert_eq!(names(&out), ["hashes.json", "set.json", "val-00000.npz"]);
}

#[test]
fn families_are_shown_beside_a_labelled_recording() {
    let place = Place::new();
    place.file("r.json", r#"{"seed": 5, "scenario": "six_step"}"#);
    place.run("synth --recipe @r.json --out @mine.npz");
    let gallery = place.json("families --episodes 1 --seed 5 --real @mine.npz --out @out");
    assert_eq!(names(&place.path("out")), ["families.json", "families.svg"]);
    let panels = gallery["synthetic"].as_array().unwrap();
    let of = |stage: &str| panels.iter().filter(|panel| panel["stage"] == stage).collect::<Vec<_>>();
    for stage in ["contact", "friction", "film", "source", "path", "disturbance", "sensor"] {
        assert_eq!(of(stage).len(), 4, "{stage}");
    }
    // The recording is the laboratory's own episode, so the first family of a stage is the recording.
    let distance = |panel: &Value| panel["from_recordings_nat"].as_f64().unwrap();
    assert_eq!((of("path")[0]["name"].as_str(), distance(of("path")[0])), (Some("modes"), 0.0));
    assert!(of("path")[1..].iter().all(|panel| distance(panel) > 0.1), "{gallery}");
    assert_eq!(of("contact")[0]["hold_counts"], gallery["recorded"]["hold_counts"]);

    unlabelled_episode().write(place.path("unlabelled.npz")).unwrap();
    let error = place.error("families --episodes 1 --real @unlabelled.npz --out @none");
    assert!(error.contains("array `label` is missing") && !place.path("none").exists(), "{error}");
}
