//! The committed world on its frozen test sets: as hard as the paper's, and without a shortcut. Prints ours
//! beside the paper's, and what the time or the rig's vibration alone gain. All data is synthetic.

use std::sync::LazyLock;

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

/// What both tests look at, simulated once.
static UMI: LazyLock<Results> = LazyLock::new(|| {
    let detectors = ["entropy", "mfcc-qda", "entropy-and-mfcc", "majority", "clock", "rig-only"];
    results(&[Split::UmiId, Split::UmiOod], &detectors)
});

fn results(splits: &[Split], detectors: &[&str]) -> Results {
    let fitted = Fitted::bundled().unwrap();
    let setup = Setup { fitted: &fitted, model: &[], float_weights: None, dead: None };
    let inputs: Vec<Input> = splits
        .iter()
        .map(|split| {
            let episodes = split.frozen().unwrap().episodes.into_iter();
            Input::recipes(split.name(), episodes.map(|e| (e.name, e.recipe)).collect())
        })
        .collect();
    let named = |name: &&str| {
        let (name, setup) = ((*name).to_owned(), &setup);
        candidate(&name.clone(), &name.clone(), move || by_name(&name, setup))
    };
    let candidates: Vec<Candidate<'_>> = detectors.iter().map(named).collect();
    let predicted = run(&inputs, &candidates, &|| {}).unwrap();
    Results::new(&inputs, &candidates, &predicted, &[])
}

#[test]
#[cfg_attr(debug_assertions, ignore = "makes half an hour of sensor data; run with --release")]
fn the_papers_baselines_land_where_they_do_in_the_paper() {
    let results = &*UMI;
    println!("{results}");
    assert_eq!(results.paper.len(), 6);
    for row in &results.paper {
        assert!(row.within_6_points, "more than {HARDNESS_POINTS} points off: {row:?}");
    }
    let slips: usize = results.inputs.iter().map(|input| input.labelled_events).sum();
    assert!(slips >= 167, "{slips} slips");
    for input in &results.inputs {
        for (ours, paper) in input.class_shares.iter().zip(CLASS_PERCENT) {
            assert!((100.0 * ours - paper).abs() <= SHARE_POINTS, "{}: {:?}", input.name, input.class_shares);
        }
    }
}

#[test]
#[cfg_attr(debug_assertions, ignore = "makes an hour of sensor data; run with --release")]
fn neither_the_time_nor_the_rig_gives_slip_away() {
    let others =
        results(&[Split::Palm, Split::Tesollo2, Split::Tesollo3], &["majority", "clock", "rig-only"]);
    for results in [&UMI, &others] {
        for (at, input) in results.inputs.iter().enumerate() {
            let f1 = |name: &str| {
                let detector = results.detectors.iter().find(|detector| detector.name == name).unwrap();
                100.0 * detector.inputs[at].figures.frame.macro_f1.unwrap()
            };
            for name in ["clock", "rig-only"] {
                let (split, majority) = (&input.name, f1("majority"));
                let gain = f1(name) - majority;
                println!("{split}: {name} gains {gain:+.2} points of macro F1 over {majority:.2}");
                assert!(gain < SHORTCUT_POINTS, "{split}: {name} gains {gain:.2} points");
            }
        }
    }
}
