//! Directions of slip, targets and integers against float, from hand-made episodes to the tables.

use serde_json::json;

use super::*;
use crate::directions::{DirectionClass, by_direction};
use crate::results::Results;
use crate::run::run;
use crate::source::Input;

/// An episode of 300 frames that slips and slides from 100 to 200.
fn slipping(scenario: &str, direction: Option<&str>) -> Episode {
    let episode = sliding(episode(300, &[100..200]), &[100..200], 5.0);
    let episode = with(episode, "scenario", json!(scenario));
    match direction {
        Some(direction) => with(episode, "slip_direction", json!(direction)),
        None => episode,
    }
}

#[test]
fn slips_are_grouped_by_direction_and_input() {
    let rig = slipping("six_step", None);
    let cases = [
        ("umi_ood", rig.clone(), Some(104)),
        ("umi_ood", rig.clone(), Some(108)),
        ("free", slipping("free_pull", Some("vertical")), Some(98)),
        ("free", slipping("free_pull", Some("other_in_plane")), Some(110)),
        ("free", slipping("free_pull", Some("other_in_plane")), None),
        ("free", slipping("rotation", Some("rotational")), Some(120)),
        ("free", with(episode(300, &[]), "slip_direction", Value::Null), Some(40)),
    ];
    let records = cases.map(|(input, episode, flag)| {
        let truth = Truth::new(&episode, input, "episode").unwrap();
        let flags: Vec<Range<usize>> = flag.iter().map(|&from| from..200).collect();
        let record = EpisodeRecord::new(&truth, &class(300, &flags));
        (truth, record)
    });
    let episodes = records.each_ref().map(|(truth, record)| (truth, record));
    let found = by_direction(&episodes);
    use DirectionClass::{OtherInPlane, Rotational, VerticalHand, VerticalRig};
    let expected = [
        (VerticalRig, "umi_ood", 2, Some(1.0), Some(6.0)),
        (VerticalHand, "free", 1, Some(1.0), None),
        (OtherInPlane, "free", 2, Some(0.5), None),
        (Rotational, "free", 1, Some(1.0), Some(20.0)),
    ];
    assert_eq!(found.len(), expected.len());
    for (of, (direction, input, slips, detected, latency)) in found.iter().zip(expected) {
        let events = &of.encoder_events;
        assert_eq!((of.direction, of.input.as_str(), events.events), (direction, input, slips));
        assert_eq!((of.detected_share, events.latency_median_frames), (detected, latency));
    }
    assert_eq!(found[1].encoder_events.early, 1);
    assert_eq!((found[2].interface_events.missed, found[2].interface_detected_share), (1, Some(0.5)));
    // The rig's alone are no comparison.
    assert!(by_direction(&episodes[..2]).is_empty());

    let error = Truth::new(&slipping("free_pull", Some("sideways")), "mine", "e7").unwrap_err().to_string();
    assert!(error.contains("mine/e7") && error.contains("`slip_direction`"), "{error}");
    assert!(error.contains("sideways"), "{error}");
}

#[test]
fn seeds_stand_beside_their_targets_and_integers_beside_float() {
    let place = tempfile::tempdir().unwrap();
    for i in 0..6 {
        let episode = slipping(["six_step", "rotation"][i % 2], [None, Some("rotational")][i % 2]);
        let episode = with(episode, "synthetic", json!(true));
        episode.write(place.path().join(format!("e{i}.npz"))).unwrap();
    }
    let inputs = ["umi_id", "mine"].map(|name| Input::folder(name, place.path()).unwrap());
    let from =
        |name: &str, family: &str, from: usize| candidate(name, family, move || Ok(flags_in(from..200)));
    let candidates = [
        from("network#1", "network", 101),
        from("network#2", "network", 104),
        from("float#1", "float", 101),
        from("float#2", "float", 105),
    ];
    let predicted = run(&inputs, &candidates, &|| ()).unwrap();
    let results = Results::new(&inputs, &candidates, &predicted, &[(0, 2), (1, 3)]);

    // The six targets of umi_id, and none of a folder that has another name.
    assert_eq!(results.targets.len(), 6);
    assert!(results.targets.iter().all(|row| row.input == "umi_id"));
    let target = |measure: &str| results.targets.iter().find(|row| row.measure == measure).unwrap();
    let latency = target("latency from onset, frames");
    assert_eq!(latency.seed_values, [Some(1.0), Some(4.0)]);
    assert_eq!((latency.mean, latency.met, latency.at_least), (Some(2.5), false, false));
    assert!((latency.standard_deviation.unwrap() - 4.5f64.sqrt()).abs() < 1e-9);
    assert!(target("macro F1 %").met && target("FPR %").met && target("early or within 5 frames %").met);
    assert_eq!((target("early or at onset %").mean, target("early or at onset %").met), (Some(0.0), false));

    // Two inputs, two seeds and their mean.
    let rows = results.integer_against_float.iter();
    let rows: Vec<_> = rows.map(|row| (row.input.as_str(), row.seed.as_str(), row.met)).collect();
    let of = |input| [(input, "network#1", true), (input, "network#2", false), (input, "mean of 2", false)];
    assert_eq!(rows, [of("umi_id"), of("mine")].concat());
    let second = &results.integer_against_float[1];
    assert_eq!((second.latency_integer_frames, second.latency_float_frames), (Some(4.0), Some(5.0)));
    assert!(second.macro_f1_difference_points.unwrap() > 0.0);
    // One frame of 300 in each of the six episodes.
    assert_eq!(second.same_class_share, Some(299.0 / 300.0));

    check_nulls(&results);
    let html = crate::report::html(&results, &predicted).unwrap();
    for shown in [results.to_string(), html] {
        for words in [
            "network beside its targets (synthetic data): 3 of 6 met",
            "integer against float (synthetic data)",
            "slips by direction (synthetic data)",
            "mean of 2",
            "2.50 ± 2.12",
            "≥ 96.8",
            "+0.000",
            "rotational",
        ] {
            assert!(shown.contains(words), "{words}: {shown}");
        }
    }
}
