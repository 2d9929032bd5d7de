//! What every detector owes: causality, state across episodes, classes by its own rule, clear errors.

use slipsense::net::Aligned;
use slipsense_eval::detectors::{DETECTORS, Detector, Setup, Verdict, by_name};
use slipsense_eval::fit::{Fitted, Plan, fit};
use slipsense_eval::source::Handle;
use slipsense_recording::Episode;
use slipsense_synth::{ObjectChoice, Platform, Recipe, ScenarioChoice, generate};

const MODEL: &[u8] = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;

/// Detectors that every build has.
fn names() -> impl Iterator<Item = &'static str> {
    DETECTORS.into_iter().map(|(name, _)| name).filter(|name| *name != "float")
}

fn with(name: &str, fitted: &Fitted, act: impl FnOnce(&mut dyn Detector)) {
    let setup = Setup { fitted, model: MODEL, float_weights: None, dead: None };
    act(&mut *by_name(name, &setup).unwrap());
}

fn judged(name: &str, fitted: &Fitted, episodes: &[&Episode]) -> Vec<Verdict> {
    let mut verdicts = Vec::new();
    with(name, fitted, |d| verdicts.extend(episodes.iter().map(|e| d.judge(e).unwrap())));
    verdicts
}

fn episode(seed: u64) -> Episode {
    generate(&Recipe { scenario: ScenarioChoice::SixStep, ..Recipe::new(seed) }).unwrap()
}

fn truths(episode: &mut Episode) -> [&mut Vec<f32>; 3] {
    [&mut episode.slip_true_mm_s, &mut episode.slip_fraction, &mut episode.displacement_mm]
        .map(|truth| truth.as_mut().unwrap())
}

/// The first `frames` frames.
fn cut(episode: &Episode, frames: usize) -> Episode {
    let mut cut = episode.clone();
    cut.piezo.truncate(frames * cut.sensors);
    cut.xl_end.truncate(frames * cut.sensors);
    let samples = *cut.xl_end.iter().max().unwrap() as usize;
    cut.xl.iter_mut().for_each(|xl| xl.truncate(samples));
    cut.label.as_mut().unwrap().truncate(frames);
    truths(&mut cut).into_iter().for_each(|truth| truth.truncate(frames));
    cut.validate().unwrap();
    cut
}

/// Two episodes as one recording.
fn joined(first: &Episode, second: &Episode) -> Episode {
    let (mut all, mut second) = (first.clone(), second.clone());
    let start: Vec<u32> = (0..all.sensors).map(|s| all.xl_end(all.frames() - 1, s)).collect();
    all.xl_end.extend(second.xl_end.iter().enumerate().map(|(i, end)| end + start[i % start.len()]));
    all.piezo.append(&mut second.piezo);
    for ((xl, later), start) in all.xl.iter_mut().zip(&second.xl).zip(&start) {
        // Samples after the last tick belong to no frame.
        xl.truncate(*start as usize);
        xl.extend(later);
    }
    let samples = all.xl.iter().map(Vec::len).max().unwrap();
    all.xl.iter_mut().for_each(|xl| xl.resize(samples, [0; 3]));
    all.label.as_mut().unwrap().append(second.label.as_mut().unwrap());
    truths(&mut all).into_iter().zip(truths(&mut second)).for_each(|(all, later)| all.append(later));
    all.validate().unwrap();
    all
}

#[test]
fn later_frames_and_samples_change_no_earlier_verdict() {
    let fitted = Fitted::bundled().unwrap();
    let whole = episode(3);
    let onset = whole.label.as_ref().unwrap().iter().position(|&class| class == 2).unwrap();
    // The rig's sound is made anew from the recipe of the whole episode; see the next test.
    for name in names().filter(|name| *name != "rig-only") {
        let all = &judged(name, &fitted, &[&whole])[0];
        for frames in [1, 200, onset, onset + 3] {
            let part = &judged(name, &fitted, &[&cut(&whole, frames)])[0];
            assert_eq!(part.class, all.class[..frames], "{name}: classes of the first {frames} frames");
            assert_eq!(part.score, all.score[..frames], "{name}: scores of the first {frames} frames");
            assert_eq!(part.fallback, all.fallback[..frames], "{name}");
        }
    }
}

#[test]
fn the_rig_detector_sees_nothing_but_the_recipe() {
    let fitted = Fitted::bundled().unwrap();
    let whole = episode(3);
    let mut other = whole.clone();
    other.xl.iter_mut().for_each(|xl| xl.fill([i16::MAX; 3]));
    other.piezo.iter_mut().for_each(|scan| *scan = slipsense::sensor::PiezoFrame::zeroed());
    other.label = None;
    assert_eq!(judged("rig-only", &fitted, &[&whole]), judged("rig-only", &fitted, &[&other]));
}

#[test]
fn state_goes_on_from_episode_to_episode_until_a_reset() {
    let fitted = Fitted::bundled().unwrap();
    let first = cut(&episode(3), 900);
    let second = Episode { meta: first.meta.clone(), ..episode(4) };
    let stream = joined(&first, &second);
    let mut carries = Vec::new();
    // What the clock and the rig's recipe know begins with each episode.
    for name in names().filter(|name| !["rig-only", "clock"].contains(name)) {
        let apart = judged(name, &fitted, &[&first, &second]);
        let whole = &judged(name, &fitted, &[&stream])[0];
        assert_eq!(apart[1].score, whole.score[first.frames()..], "{name}: one recording or two episodes");
        assert_eq!(apart[1].class, whole.class[first.frames()..], "{name}");
        let fresh = &judged(name, &fitted, &[&second])[0];
        if fresh.score != apart[1].score {
            carries.push(name);
        }
        with(name, &fitted, |detector| {
            detector.judge(&first).unwrap();
            detector.reset();
            assert_eq!(&detector.judge(&second).unwrap(), fresh, "{name}: after a reset");
        });
    }
    println!("verdict depends on the episode before: {carries:?}");
    let expected = [
        "network",
        "network-alarm",
        "entropy",
        "mfcc-qda",
        "entropy-and-mfcc",
        "energy",
        "flux-cusum",
        "band-pass",
        "logistic",
    ];
    assert_eq!(carries, expected);
}

#[test]
fn classes_follow_from_score_threshold_and_fallback() {
    let fitted = Fitted::bundled().unwrap();
    let episode = episode(5);
    for name in names() {
        let verdict = &judged(name, &fitted, &[&episode])[0];
        assert_eq!(verdict.class.len(), episode.frames(), "{name}");
        assert!(verdict.score.iter().all(|score| score.is_finite()), "{name}");
        assert!(verdict.fallback.iter().all(|&class| class < 2), "{name}");
        let by_rule = Verdict::new(verdict.score.clone(), verdict.threshold, verdict.fallback.clone());
        assert_eq!(by_rule.class, verdict.class, "{name}");
        let slips = verdict.class.iter().filter(|&&class| class == 2).count();
        println!("{name:<17} slip in {slips:>4} of {} frames", episode.frames());
    }
}

#[test]
fn one_and_three_sensors_and_a_change_between_them() {
    let fitted = Fitted::bundled().unwrap();
    let platform = Platform::Tesollo;
    let of = |sensors| generate(&Recipe { platform, sensors, seconds: Some(2.5), ..Recipe::new(6) }).unwrap();
    let (one, three) = (of(1), of(3));
    for name in names() {
        let both = judged(name, &fitted, &[&one, &three]);
        assert_eq!(both[1], judged(name, &fitted, &[&three])[0], "{name}: another number starts anew");
    }
}

#[test]
fn both_baselines_together_slip_where_each_does() {
    let fitted = Fitted::bundled().unwrap();
    let episode = episode(7);
    let slip = |name| {
        let verdict = judged(name, &fitted, &[&episode]).remove(0);
        verdict.class.iter().map(|&class| class == 2).collect::<Vec<_>>()
    };
    let (a, b, both) = (slip("entropy"), slip("mfcc-qda"), slip("entropy-and-mfcc"));
    let count = |flags: &[bool]| flags.iter().filter(|&&flag| flag).count();
    println!("slip frames: entropy {}, mfcc {}, both {}", count(&a), count(&b), count(&both));
    assert_eq!(both, a.iter().zip(&b).map(|(&a, &b)| a && b).collect::<Vec<_>>());
    assert!(count(&both) > 0 && count(&both) < count(&a).min(count(&b)));
}

#[test]
fn contact_first_silences_the_untouched_pad() {
    let fitted = Fitted::bundled().unwrap();
    let contact_first = slipsense_eval::detectors::ClassOrder::ContactFirst;
    let contact_first = Fitted { class_order: contact_first, ..fitted.clone() };
    let episode = episode(7);
    let a = &judged("mfcc-qda", &fitted, &[&episode])[0];
    let b = &judged("mfcc-qda", &contact_first, &[&episode])[0];
    let mut silenced = 0;
    for frame in 0..episode.frames() {
        match b.fallback[frame] {
            0 => {
                assert_eq!(b.class[frame], 0);
                silenced += usize::from(a.class[frame] == 2);
            }
            _ => assert_eq!((a.class[frame], a.score[frame]), (b.class[frame], b.score[frame])),
        }
    }
    println!("{silenced} frames without contact are slip if slip is decided first");
    assert!(silenced > 0);
}

#[test]
fn bad_setups_are_refused_in_words() {
    let fitted = Fitted::bundled().unwrap();
    let error = |name: &str, setup: Setup<'_>| match by_name(name, &setup) {
        Ok(detector) => panic!("{} was made", detector.name()),
        Err(error) => format!("{error:#}"),
    };
    let setup = Setup { fitted: &fitted, model: MODEL, float_weights: None, dead: None };
    assert!(error("entropi", setup).contains("there are: network, "));
    assert!(error("network", Setup { model: &MODEL[..100], ..setup }).starts_with("model: "));
    let without = Fitted { rig_only: None, ..fitted.clone() };
    assert!(error("rig-only", Setup { fitted: &without, ..setup }).contains("not fitted"));

    let mut recorded = episode(8);
    recorded.meta.other.remove("recipe");
    recorded.slip_true_mm_s = None;
    with("rig-only", &fitted, |d| assert!(d.judge(&recorded).unwrap_err().to_string().contains("recipe")));
    with("oracle", &fitted, |d| assert!(d.judge(&recorded).unwrap_err().to_string().contains("slip_true")));
}

#[test]
fn a_damaged_file_of_fitted_numbers_is_refused() {
    let fitted = Fitted::bundled().unwrap();
    let refused = |change: fn(&mut Fitted)| {
        let mut damaged = fitted.clone();
        change(&mut damaged);
        let error = Fitted::from_json(&damaged.to_json().unwrap()).unwrap_err();
        println!("{error:#}");
        format!("{error:#}")
    };
    assert!(refused(|f| f.format += 1).contains("format"));
    assert!(refused(|f| f.data.split = "val".into()).contains("split"));
    assert!(refused(|f| f.clock[3][0] += 1).contains("clock"));
    assert!(refused(|f| f.energy.std = 0.0).contains("energy"));
    assert!(refused(|f| f.mfcc.scaling.std[2] = 0.0).contains("mfcc.scaling"));
    assert!(refused(|f| f.mfcc.slip.covariance[0][0] = -1.0).contains("positive definite"));
    assert!(refused(|f| f.logistic.weights.truncate(11)).contains("logistic.weights"));
    assert!(Fitted::from_json("{}").is_err());
    assert_eq!(Fitted::from_json(&fitted.to_json().unwrap()).unwrap(), fitted, "unchanged, it is read back");
}

#[test]
fn fitting_repeats_itself_and_refuses_held_out_objects() {
    let base = Recipe { seconds: Some(5.0), scenario: ScenarioChoice::SixStep, ..Recipe::new(2) };
    let handle = |recipe: Recipe| Handle::Recipe { name: "this one".into(), recipe: Box::new(recipe) };
    let episodes: Vec<_> = base.series(4).into_iter().map(handle).collect();
    let run = || fit(&episodes, "test", Plan::default(), || ()).unwrap();
    assert_eq!(run(), run());
    let held_out = [handle(Recipe { object: ObjectChoice::HeldOut, ..base })];
    let error = format!("{:#}", fit(&held_out, "test", Plan::default(), || ()).unwrap_err());
    assert!(error.starts_with("this one: ") && error.contains("held out"), "{error}");
}
