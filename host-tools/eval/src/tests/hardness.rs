//! The committed world on its frozen test sets: as hard as the paper's, and without a shortcut. Prints ours
//! beside the paper's, and what the time or the rig's vibration alone gain. All data is synthetic.

use std::sync::LazyLock;

use slipsense_synth::Split;

use super::*;
use crate::detectors::{Setup, by_name};
use crate::fitted::Fitted;
use crate::paper::{CLASS_PERCENT, HARDNESS_POINTS};
use crate::results::{DetectorResults, Results};
use crate::run::run;
use crate::source::Input;

/// How far a class's share may be from the paper's, points.
const SHARE_POINTS: f64 = 2.0;
/// How much macro F1 a shortcut may gain over the majority class, points.
const SHORTCUT_POINTS: f64 = 2.0;

const UMI_SPLITS: [Split; 2] = [Split::UmiId, Split::UmiOod];
const OTHER_SPLITS: [Split; 5] =
    [Split::Palm, Split::Tesollo2, Split::Tesollo3, Split::TransferKnown, Split::TransferAll];
const BASELINES: [&str; 3] = ["entropy", "mfcc-qda", "entropy-and-mfcc"];
/// The first is the one that the others are compared with.
const SHORTCUTS: [&str; 4] = ["majority", "clock", "rig-only", "idle-noise"];

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

/// The paper's baselines and the shortcuts on the UMI splits: both tests need these episodes, which are made once.
static UMI: LazyLock<Results> =
    LazyLock::new(|| results(&UMI_SPLITS, &[&BASELINES[..], &SHORTCUTS].concat()));

#[test]
#[cfg_attr(debug_assertions, ignore = "makes hours of sensor data; run with --release")]
fn the_papers_baselines_land_where_they_do_in_the_paper() {
    println!("{}", *UMI);
    assert_eq!(UMI.paper.len(), 6);
    for row in &UMI.paper {
        assert!(row.within_6_points, "more than {HARDNESS_POINTS} points off: {row:?}");
    }
    let slips: usize = UMI.inputs.iter().map(|input| input.labelled_events).sum();
    assert!(slips >= 167, "{slips} slips");
    for input in &UMI.inputs {
        for (ours, paper) in input.class_shares.iter().zip(CLASS_PERCENT) {
            assert!((100.0 * ours - paper).abs() <= SHARE_POINTS, "{}: {:?}", input.name, input.class_shares);
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "makes hours of sensor data; run with --release")]
fn neither_time_nor_rig_nor_idle_noise_give_slip_away() {
    let others = results(&OTHER_SPLITS, &SHORTCUTS);
    for results in [&*UMI, &others] {
        let f1 = |name: &str, input: usize| {
            let of = |detector: &&DetectorResults| detector.name == name;
            let detector = results.detectors.iter().find(of).unwrap();
            100.0 * detector.inputs[input].figures.frame.macro_f1.unwrap()
        };
        for (input, split) in results.inputs.iter().enumerate() {
            let [majority, shortcuts @ ..] = SHORTCUTS;
            for name in shortcuts {
                let (gain, split) = (f1(name, input) - f1(majority, input), &split.name);
                println!("{split}: {name} gains {gain:+.2} points of macro F1");
                assert!(gain < SHORTCUT_POINTS, "{split}: {name} gains {gain:.2} points");
            }
        }
    }
}
