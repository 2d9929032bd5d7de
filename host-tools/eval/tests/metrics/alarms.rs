//! False alarms, by hand.

use super::*;

fn of(figures: &Figures, name: &str) -> (u64, f64) {
    let class = figures.alarms.by_disturbance.iter().find(|class| class.disturbance == name).unwrap();
    (class.rate.alarms, class.rate.exposure_hours * HOUR)
}

#[test]
fn alarms_are_merged_and_put_down_to_what_went_on() {
    let events = json!([
        {"name": "tap", "start_s": 1.0, "end_s": 1.0},
        {"name": "motion", "start_s": 0.5, "end_s": 2.0},
    ]);
    let truth = truth(&with(episode(1440, &[1000..1100]), "events", events));
    // Two runs 47 frames apart at the tap; one in the motion; one where nothing goes on; slip.
    let flags = [250..253, 300..310, 400..401, 700..702, 1000..1100];
    let figures = Figures::new([&Record::new(&truth, &class(1440, &flags))]);
    assert_eq!(figures.alarms.all.alarms, 3);
    // 240 to 276: the tap and 150 ms. Motion from 120 to 516, less the tap.
    assert_eq!(of(&figures, "tap"), (1, 37.0));
    assert_eq!(of(&figures, "motion"), (1, 397.0 - 37.0));
    // 1440 frames, less 124 of slip and its margins.
    let (alarms, frames) = of(&figures, "none");
    assert_eq!(alarms, 1);
    assert!((frames - (1440.0 - 397.0 - 124.0)).abs() < 1e-6, "{frames}");
    let exposure: f64 = figures.alarms.by_disturbance.iter().map(|c| c.rate.exposure_hours).sum();
    assert!((exposure - figures.alarms.all.exposure_hours).abs() < 1e-12);
    let per_hour = figures.alarms.all.alarms_per_hour.unwrap();
    assert!((per_hour - 3.0 * HOUR / (1440.0 - 124.0)).abs() < 1e-6);
    assert!(figures.alarms.all.upper_bound_per_hour.unwrap() > per_hour);
}

#[test]
fn an_alarm_belongs_to_its_start() {
    let events = json!([{"name": "lift", "start_s": 1.0, "end_s": 1.1}]);
    let truth = truth(&with(episode(960, &[]), "events", events));
    let figures = Figures::new([&Record::new(&truth, &class(960, &[200..280, 600..601]))]);
    assert_eq!((of(&figures, "lift").0, of(&figures, "none").0), (0, 2));
}

#[test]
fn alarms_of_true_sliding_are_told_apart() {
    let truth = truth(&sliding(episode(960, &[]), &[300..400], 3.0));
    let figures = Figures::new([&Record::new(&truth, &class(960, &[310..320, 700..710]))]);
    assert_eq!((figures.alarms.all.alarms, figures.alarms.of_these_truly_sliding), (2, Some(1)));
    assert_eq!(figures.alarms.against_interface.unwrap().alarms, 1);
}

#[test]
fn nothing_is_known_of_the_interface_where_one_episode_does_not_say() {
    let knows = truth(&sliding(episode(960, &[]), &[300..400], 3.0));
    let not = truth(&episode(960, &[]));
    let quiet = class(960, &[]);
    let figures = Figures::new([&Record::new(&knows, &quiet), &Record::new(&not, &quiet)]);
    assert_eq!((figures.alarms.of_these_truly_sliding, figures.alarms.against_interface), (None, None));
}

#[test]
fn every_class_has_a_place() {
    for (i, name) in CLASSES.iter().enumerate() {
        assert_eq!(CLASSES.iter().position(|other| other == name), Some(i));
    }
}
