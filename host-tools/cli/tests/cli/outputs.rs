//! What the commands write, and that it all tells the same story.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::BufReader;
use std::path::Path;

use crate::support::{Place, assert_says, names, unlabelled_episode};
use serde_json::Value;
use slipsense::fixed::Q;
use slipsense::params::CONTACT_SUM_MIN;
use slipsense::pipeline::FrameStamp;
use slipsense::wire::{NodeId, Received, Receiver, wire_logit};
use slipsense_recording::candump::CandumpReader;
use slipsense_recording::npz::Reader;
use slipsense_recording::{Episode, Predictions};

const FILES: [&str; 5] = ["can.log", "predictions.npz", "report.html", "summary.json", "timeline.svg"];

fn check(folder: &Path, episode: &Episode) -> (Predictions, Value) {
    assert_eq!(names(folder), FILES);
    let predictions = Predictions::read(folder.join("predictions.npz")).unwrap();
    let summary: Value = serde_json::from_slice(&fs::read(folder.join("summary.json")).unwrap()).unwrap();
    assert_eq!(predictions.frames(), episode.frames());
    check_summary(&summary, &predictions, episode);
    check_empty_pads(&predictions, episode);
    check_log(&folder.join("can.log"), &predictions, episode, &summary);
    let svg = fs::read_to_string(folder.join("timeline.svg")).unwrap();
    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    // The letters of a picture's bytes may happen to spell it.
    assert!(svg.split('"').all(|part| part.contains("base64,") || !part.contains("NaN")));
    assert!(svg.len() < 1_500_000, "{} bytes", svg.len());
    assert!(report.contains(svg.trim_end()) && !report.contains("{{"));
    for outside in ["src=\"http", "href=\"http", "url(", "@import"] {
        assert!(!report.contains(outside), "loads nothing: {outside}");
    }
    (predictions, summary)
}

fn check_summary(summary: &Value, predictions: &Predictions, episode: &Episode) {
    let count =
        |classes: &[u8]| (0..3).map(|c| classes.iter().filter(|&&x| x == c).count()).collect::<Vec<_>>();
    assert_eq!(summary["episode"]["frames"], episode.frames());
    assert_eq!(summary["episode"]["sensors"], episode.sensors);
    assert_eq!(summary["output"]["class_frames"], Value::from(count(&predictions.class)));
    for (runs, flag) in [("may_begin_runs", &predictions.may_begin), ("slip_runs", &predictions.slip)] {
        let flagged: u64 = summary["output"][runs]
            .as_array()
            .unwrap()
            .iter()
            .map(|run| run["end_frame"].as_u64().unwrap() - run["start_frame"].as_u64().unwrap())
            .sum();
        assert_eq!(flagged, flag.iter().map(|&s| u64::from(s)).sum::<u64>(), "{runs}");
    }
    let Some(label) = &episode.label else {
        assert!(summary["truth"].is_null());
        return;
    };
    assert_eq!(summary["truth"]["class_frames"], Value::from(count(label)));
    for event in summary["truth"]["events"].as_array().unwrap() {
        let onset = event["onset_frame"].as_u64().unwrap() as usize;
        assert_eq!((label[onset], label[onset - 1] != 2), (2, true));
        if let Some(delay) = event["delay_frames"].as_i64() {
            assert_eq!(predictions.may_begin[(onset as i64 + delay) as usize], 1);
            assert!((event["delay_ms"].as_f64().unwrap() - delay as f64 / 0.24).abs() < 1e-9);
        }
    }
}

/// Per-unit rule: no contact exactly where every pad's sum is below the threshold.
fn check_empty_pads(predictions: &Predictions, episode: &Episode) {
    for frame in 0..episode.frames() {
        let empty = (0..episode.sensors).all(|s| episode.piezo(frame, s).sum() < CONTACT_SUM_MIN);
        assert_eq!(predictions.class[frame] == 0, empty, "frame {frame}");
    }
}

/// In each period first the slip message, then one raw frame per sensor, and all say what was seen.
fn check_log(path: &Path, predictions: &Predictions, episode: &Episode, summary: &Value) {
    let mut receiver = Receiver::new(NodeId::DEFAULT);
    let mut periods: BTreeMap<u64, Vec<Received>> = BTreeMap::new();
    let mut frames = 0;
    for entry in CandumpReader::new(BufReader::new(File::open(path).unwrap())) {
        let entry = entry.unwrap();
        frames += 1;
        if let Some(message) = receiver.accept(&entry.frame).unwrap() {
            periods.entry(entry.timestamp_us).or_default().push(message);
        }
    }
    assert_eq!(summary["output"]["can_frames"], frames);
    assert_eq!(periods.len(), episode.frames());
    for (frame, (time, messages)) in periods.into_iter().enumerate() {
        assert_eq!(time, FrameStamp::of_recording(frame as u32).timestamp_us);
        assert_eq!(messages.len(), 1 + episode.sensors);
        let Received::Slip(slip) = &messages[0] else { panic!("frame {frame}: slip message first") };
        assert_eq!((slip.class, slip.slip), (predictions.class[frame], predictions.slip[frame] != 0));
        assert_eq!(slip.may_begin, predictions.may_begin[frame] != 0);
        assert_eq!(slip.logits, predictions.logits[frame].map(Q::from_bits).map(wire_logit));
        for (sensor, message) in messages[1..].iter().enumerate() {
            let Received::Raw(raw) = message else { panic!("frame {frame}: raw frame") };
            assert_eq!(usize::from(raw.sensor), sensor);
            assert_eq!(&raw.piezo, episode.piezo(frame, sensor));
            assert_eq!(&raw.xl[..], episode.xl_batch(frame, sensor));
            assert_eq!(raw.xl_end, episode.xl_end(frame, sensor));
        }
    }
}

const RUN: &str = "run @e.npz --model @m.slipnet --out @deep/out";

#[test]
fn run_with_labels_writes_everything() {
    let place = Place::with_files();
    let (table, out) = (place.run(RUN), place.path("deep/out"));
    let (predictions, summary) = check(&out, &Episode::read(place.path("e.npz")).unwrap());
    assert_eq!(summary["truth"]["events"].as_array().unwrap().len(), 1);
    assert_eq!(summary["episode"]["synthetic"], false);
    assert_eq!(place.names(), ["deep", "e.npz", "m.slipnet"]);
    assert_says(
        &table,
        &["event", "false alarms", "1 of 1 frame over 0.000 nat", "frames/s on one core", "report.html"],
    );

    // A second run replaces the first.
    let first = fs::read(out.join("can.log")).unwrap();
    fs::write(out.join("timeline.svg"), "old").unwrap();
    fs::write(out.join("notes.txt"), "mine").unwrap();
    place.run(RUN);
    assert_eq!(fs::read(out.join("can.log")).unwrap(), first, "the same bytes");
    assert_ne!(fs::read(out.join("timeline.svg")).unwrap(), b"old");
    assert_eq!(names(&out), [&FILES[..1], &["notes.txt"], &FILES[1..]].concat());
    assert_eq!(fs::read(out.join("notes.txt")).unwrap(), b"mine");

    // `features` writes those of the pipeline.
    place.run("features @e.npz --out @f.npz");
    let mut npz = Reader::open(&place.path("f.npz")).unwrap();
    for (name, expected) in [("logmel", &predictions.logmel), ("logmel_std", &predictions.logmel_std)] {
        let array = npz.array::<f32>(name).unwrap();
        assert_eq!(array.shape(), [predictions.frames(), predictions.sensors, 16]);
        assert_eq!(array.read().unwrap(), expected.concat());
    }
}

#[test]
fn run_without_labels_has_no_delays() {
    let place = Place::with_files();
    unlabelled_episode().write(place.path("e.npz")).unwrap();
    let json = place.json(RUN);
    let (_, summary) = check(&place.path("deep/out"), &Episode::read(place.path("e.npz")).unwrap());
    assert_eq!(json, summary, "--json prints summary.json");
}

/// The demo as a user starts it. The unoptimised pipeline takes some seconds for it.
#[test]
fn demo_writes_everything() {
    let place = Place::new();
    let out = place.path("demo");
    let json = place.json("demo --out @demo");
    let demo = Path::new(env!("CARGO_MANIFEST_DIR")).join("demo");
    let episode = Episode::read(demo.join("episode.npz")).unwrap();
    let (_, summary) = check(&out, &episode);
    assert_eq!(json, summary);
    assert_eq!(summary["episode"]["synthetic"], true);
    assert!(summary["truth"]["events"].as_array().is_some_and(|events| !events.is_empty()));
    assert!(fs::read_to_string(out.join("report.html")).unwrap().contains("<strong>synthetic</strong>"));
    let committed = demo.join("timeline.svg");
    let same = fs::read(&committed).unwrap() == fs::read(out.join("timeline.svg")).unwrap();
    assert!(same, "{}, the README's picture, is not what the demo draws: copy it anew", committed.display());
}

#[test]
fn the_bundled_model_is_a_trained_one() {
    let info = Place::new().json("model info");
    let provenance = &info["model"]["provenance"];
    assert!(provenance.is_object() && provenance.get("random").is_none(), "{provenance}");
}

#[test]
fn help_has_examples() {
    for command in ["", "demo", "run", "features", "synth", "label"] {
        let help = Place::new().run(&format!("{command} --help"));
        assert!(help.contains("Example"), "{command}");
    }
}

/// The book's page of commands is what the commands say. To write it anew: `slipsense help-markdown`. Where the trainer is
/// built, the page says less of it, so that only the other commands compare.
#[test]
fn the_books_page_of_commands_is_the_help() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/src/tools/cli.md");
    let (page, help) = (fs::read_to_string(&path).unwrap(), Place::new().run("help-markdown"));
    let with_trainer = cfg!(feature = "train");
    let of_trainer = |section: &str| section.contains("feature `train`") || section.contains("no trainer");
    let sections = page.split("\n## ").filter(|section| !with_trainer || !of_trainer(section));
    let same =
        sections.clone().count() > 20 && sections.clone().all(|section| help.contains(section.trim_end()));
    let write = "write it anew with `cargo run --release -- help-markdown`";
    assert!(same && (with_trainer || page == help), "{}: {write}", path.display());
}
