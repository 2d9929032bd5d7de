//! Slips found, early, late and missed, by hand.

use slipsense_recording::score::Detection::{Early, Hit, Missed};

use super::*;
use crate::metrics::events::Cdf;

#[test]
fn hits_early_ones_late_ones_and_misses_by_hand() {
    // Five events of 100 frames, 300 apart: hit at 0, hit at 4, early by 3, late (a miss), missed.
    let slips: Vec<_> = (0..5).map(|i| 300 * i + 100..300 * i + 200).collect();
    let record = record(&episode(1600, &slips), &[100..110, 404..410, 697..720, 1100..1105]);
    let detections: Vec<_> = record.events.encoder.iter().map(|o| o.event.detection).collect();
    assert_eq!(detections, [Hit { delay: 0 }, Hit { delay: 4 }, Early { lead: 3 }, Missed, Missed]);
    let figures = Figures::new([&record]);
    let events = &figures.encoder_events;
    assert_eq!((events.events, events.hits, events.early, events.missed), (5, 2, 1, 2));
    // Hits and misses: 0, 4, infinite, infinite.
    assert_eq!(events.latency_median_frames, None);
    assert_eq!(events.within_5_frames_share, Some(0.5));
    assert_eq!((events.miss_share, events.early_share), (Some(0.4), Some(0.2)));
    assert_eq!(
        (events.latency_max_of_hits_frames, events.latency_mean_of_hits_frames),
        (Some(4.0), Some(2.0))
    );
    assert_eq!((events.latency_p90_frames, events.latency_p95_frames), (None, None));
    // From the onset on: 0, 4, 0 (the flag stays up), infinite, infinite.
    assert_eq!(events.from_onset_median_frames, Some(4.0));
    assert_eq!(events.at_onset_share, Some(0.4));
    // Of all five: the early one and that at 0; with that at 4.
    assert_eq!(events.early_or_at_onset_share, Some(0.4));
    assert_eq!(events.early_or_within_5_frames_share, Some(0.6));
    assert_eq!(events.at_onset_with_transition_share, Some(0.2));
    // The flag at 1100 is within 50 ms after the end: no hit and no alarm.
    assert_eq!(figures.alarms.all.alarms, 0);
    let cdf = Cdf::new(&record.events.encoder);
    assert_eq!((cdf.latency_at_most_frames, cdf.events_share), (vec![0, 4], vec![0.25, 0.5]));
}

#[test]
fn the_distribution_starts_at_zero() {
    let episode = episode(1000, &[100..200, 400..500, 700..800]);
    let record = record(&episode, &[103..200, 403..500, 707..800]);
    let cdf = Cdf::new(&record.events.encoder);
    assert_eq!(cdf.latency_at_most_frames, [0, 3, 7]);
    assert_eq!(cdf.events_share, [0.0, 2.0 / 3.0, 1.0]);
    let figures = Figures::new([&record]).encoder_events;
    assert_eq!((figures.latency_median_frames, figures.latency_p76_frames), (Some(3.0), Some(7.0)));
}

#[test]
fn both_truths_by_hand() {
    // Labelled from 100, slides from 112; labelled from 500, never slides.
    let episode = sliding(episode(800, &[100..200, 500..600]), &[112..190], 24.0);
    let truth = truth(&episode);
    let interface = truth.interface.as_ref().unwrap();
    assert_eq!((&interface.slip[..], &interface.of_label[..]), (&[(112, 190)][..], &[Some(0), None][..]));
    let figures = figures(&episode, &[115..210, 520..530]);
    assert_eq!(figures.encoder_events.latency_median_frames, Some((15.0 + 20.0) / 2.0));
    assert_eq!(figures.interface_events.latency_median_frames, Some(3.0));
    assert_eq!((figures.interface_events.events, figures.labelled_without_interface_slip), (1, 1));
    // Three frames at 24 mm/s.
    let slid = figures.interface_events.travel_median_mm.unwrap();
    assert!((slid - 0.3).abs() < 1e-6);
    // The sliding ends at 190, so the flag up to 210 outlasts its margin, and that at 520 is alone.
    assert_eq!(figures.alarms.all.alarms, 0);
    assert_eq!(figures.alarms.against_interface.unwrap().alarms, 2);
}

#[test]
fn a_flag_before_the_sliding_is_early_against_the_interface() {
    let record = record(&sliding(episode(400, &[100..200]), &[110..200], 5.0), &[101..200]);
    assert_eq!(record.events.encoder[0].event.detection, Hit { delay: 1 });
    assert_eq!(record.events.interface[0].event.detection, Early { lead: 9 });
}

#[test]
fn sliding_is_closed_sustained_and_near_its_label() {
    // A gap of 11 frames is closed, one of 12 is not; 11 frames alone are not sustained.
    let slides = [100..130, 141..150, 162..180, 300..311];
    let truth = truth(&sliding(episode(1000, &[161..220, 260..330, 900..950]), &slides, 1.0));
    let interface = truth.interface.unwrap();
    assert_eq!(interface.slip, [(100, 150), (162, 180)]);
    // 100 is more than 60 frames before 161 and so is 162 before 260.
    assert_eq!(interface.of_label, [Some(1), None, None]);
}

#[test]
fn the_crossheads_travel_by_hand() {
    let mut episode = episode(400, &[100..200]);
    episode.displacement_mm = Some((0..400).map(|f| 0.02 * f as f32).collect());
    let hit = record(&episode, &[105..120]);
    let figures = Figures::new([&hit]).encoder_events;
    assert!((figures.travel_median_mm.unwrap() - 0.1).abs() < 1e-6);
    assert!((figures.travel_max_of_hits_mm.unwrap() - 0.1).abs() < 1e-6);
    // A miss is infinitely far.
    let both = Figures::new([&hit, &record(&episode, &[])]).encoder_events;
    assert_eq!((both.travel_median_mm, both.travel_p90_mm), (None, None));
    assert!(both.travel_max_of_hits_mm.is_some());
}
