//! The committed world on its frozen test sets: as hard as the paper's, and without a shortcut. Prints ours
//! beside the paper's, and what the time or the rig's vibration alone gain. All data is synthetic.

use slipsense_synth::Split;

use super::*;
use crate::detectors::{Setup, by_name};
use crate::fitted::Fitted;
use crate::paper::{CLASS_PERCENT, HARDNESS_POINTS};
use crate::results::Results;
use crate::run::run;
use crate::source::Input;

/// How far a class's share may be from the paper's, points.
const SHARE_POINTS: f64 = 2.0;
/// How much macro F1 a shortcut may gain over the majority class, points.
const SHORTCUT_POINTS: f64 = 2.0;

const SPLITS: [Split; 5] = [Split::UmiId, Split::UmiOod, Split::Palm, Split::Tesollo2, Split::Tesollo3];

/// What the detectors make of frozen splits, generated here.
fn results(splits: &[Split], detectors: &[&'static str]) -> Results {
    let fitted = Fitted::bundled().unwrap();
    let setup = Setup { fitted: &fitted, model: &[], float_weights: None, dead: None };
    let inputs: Vec<_> = splits
        .iter()
        .map(|split| {
            let episodes = split.frozen().unwrap().episodes.into_iter();
            Input::recipes(split.name(), episodes.map(|e| (e.name, e.recipe)).collect())
        })
        .collect();
    let setup = &setup;
    let named = |name: &&'static str| -> _ {
        let name = *name;
        candidate(name, name, move || by_name(name, setup))
    };
    let candidates: Vec<_> = detectors.iter().map(named).collect();
    let predicted = run(&inputs, &candidates, &|| {}).unwrap();
    Results::new(&inputs, &candidates, &predicted, &[])
}

#[test]
#[cfg_attr(debug_assertions, ignore = "makes hours of sensor data; run with --release")]
fn the_papers_baselines_land_where_they_do_in_the_paper() {
    let results = results(&SPLITS[..2], &["entropy", "mfcc-qda", "entropy-and-mfcc"]);
    println!("{results}");
    assert_eq!(results.paper.len(), 6);
    for row in &results.paper {
        assert!(row.within_6_points, "more than {HARDNESS_POINTS} points off: {row:?}");
    }
    let slips: usize = results.inputs[..2].iter().map(|input| input.labelled_events).sum();
    assert!(slips >= 167, "{slips} slips");
    for input in &results.inputs[..2] {
        for (ours, paper) in input.class_shares.iter().zip(CLASS_PERCENT) {
            assert!((100.0 * ours - paper).abs() <= SHARE_POINTS, "{}: {:?}", input.name, input.class_shares);
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "makes hours of sensor data; run with --release")]
fn neither_time_nor_rig_nor_idle_noise_give_slip_away() {
    let splits: Vec<Split> = SPLITS.into_iter().chain([Split::TransferKnown, Split::TransferAll]).collect();
    no_gain(&splits, &["majority", "clock", "rig-only", "idle-noise"]);
}

/// The first detector is the one that the others are compared with.
fn no_gain(splits: &[Split], detectors: &[&'static str]) {
    let results = results(splits, detectors);
    for (input, split) in splits.iter().enumerate() {
        let f1 = |detector: usize| {
            100.0 * results.detectors[detector].inputs[input].figures.frame.macro_f1.unwrap()
        };
        for (detector, name) in detectors.iter().enumerate().skip(1) {
            let gain = f1(detector) - f1(0);
            println!("{split}: {name} gains {gain:+.2} points of macro F1");
            assert!(gain < SHORTCUT_POINTS, "{split}: {name} gains {gain:.2} points");
        }
    }
}
