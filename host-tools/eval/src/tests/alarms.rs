//! False alarms, by hand.

use serde_json::json;

use super::*;

const HOUR: f64 = 240.0 * 3600.0;

/// Alarms and exposure of a disturbance, frames.
fn of_class(figures: &Figures, name: &str) -> (u64, f64) {
    let class = figures.alarms.by_disturbance.iter().find(|class| class.disturbance == name).unwrap();
    (class.rate.alarms, class.rate.exposure_hours * HOUR)
}

#[test]
fn alarms_are_merged_and_attributed_to_what_happened() {
    let events = json!([
        {"name": "tap", "start_s": 1.0, "end_s": 1.0},
        {"name": "motion", "start_s": 0.5, "end_s": 2.0},
    ]);
    let episode = with(episode(1440, &[1000..1100]), "events", events);
    // Two runs 47 frames apart at the tap; one in the motion; one without a disturbance; slip.
    let figures = figures(&episode, &[250..253, 300..310, 400..401, 700..702, 1000..1100]);
    assert_eq!(figures.alarms.all.alarms, 3);
    // 240 to 276: the tap and 150 ms. Motion from 120 to 516, less the tap.
    assert_eq!(of_class(&figures, "tap"), (1, 37.0));
    assert_eq!(of_class(&figures, "motion"), (1, 397.0 - 37.0));
    // 1440 frames, less 124 of slip and its margins.
    let (alarms, frames) = of_class(&figures, "none");
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
    let figures = figures(&with(episode(960, &[]), "events", events), &[200..280, 600..601]);
    assert_eq!((of_class(&figures, "lift").0, of_class(&figures, "none").0), (0, 2));
}

#[test]
fn alarms_of_true_sliding_are_counted_apart_where_every_episode_knows() {
    let slides = sliding(episode(960, &[]), &[300..400], 3.0);
    let figures = figures(&slides, &[310..320, 700..710]);
    assert_eq!((figures.alarms.all.alarms, figures.alarms.of_these_truly_sliding), (2, Some(1)));
    assert_eq!(figures.alarms.against_interface.unwrap().alarms, 1);
    let both = Figures::new([&record(&slides, &[]), &record(&episode(960, &[]), &[])]);
    assert_eq!((both.alarms.of_these_truly_sliding, both.alarms.against_interface), (None, None));
}
