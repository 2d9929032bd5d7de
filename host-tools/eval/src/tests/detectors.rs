//! What every detector owes: causality, state across episodes, classes by its own rule, clear errors.

use std::collections::BTreeMap;
use std::sync::LazyLock;

use slipsense::fixed::Logit;
use slipsense::net::Aligned;
use slipsense::net::format::{Dims, OperatingPoint};
use slipsense_recording::model_file::random_model;
use slipsense_synth::{ObjectChoice, Platform, Recipe, ScenarioChoice, generate};

use super::*;
use crate::detector::{ClassOrder, NEVER};
use crate::detectors::{DETECTORS, Modality, Setup, by_name};
use crate::fit::{Plan, fit};
use crate::fitted::Fitted;
use crate::source::Handle;

const MODEL: &[u8] = &Aligned(*include_bytes!("../../../../model/weights/slipsense.slipnet")).0;

/// Of a network of random weights.
const SMALL: Dims =
    Dims { conv_channels: [2, 2, 2], embed: 4, xl_kernel: 2, xl_channels: 4, heads: 2, window: 8 };

/// They look at the recipe of an episode and at nothing else.
const RECIPE_ALONE: [&str; 2] = ["rig-only", "idle-noise"];

static FITTED: LazyLock<Fitted> = LazyLock::new(|| Fitted::bundled().unwrap());

/// A generated episode, and what every detector predicts for it alone.
static WHOLE: LazyLock<(Episode, BTreeMap<&str, Prediction>)> = LazyLock::new(|| {
    let whole = generated(3);
    let predictions = names().map(|name| (name, predict(name, &[&whole]).remove(0))).collect();
    (whole, predictions)
});

/// Detectors that every build has.
fn names() -> impl Iterator<Item = &'static str> {
    DETECTORS.into_iter().map(|(name, _)| name).filter(|name| *name != "float")
}

fn setup() -> Setup<'static> {
    Setup { fitted: &FITTED, model: MODEL, float_weights: None, dead: None }
}

fn predict_with(name: &str, setup: &Setup<'_>, episodes: &[&Episode]) -> Vec<Prediction> {
    let mut detector = by_name(name, setup).unwrap();
    episodes.iter().map(|episode| detector(episode).unwrap()).collect()
}

fn predict(name: &str, episodes: &[&Episode]) -> Vec<Prediction> {
    predict_with(name, &setup(), episodes)
}

fn generated(seed: u64) -> Episode {
    generate(&Recipe { scenario: ScenarioChoice::SixStep, ..Recipe::new(seed) }).unwrap()
}

fn truths(episode: &mut Episode) -> [&mut Vec<f32>; 3] {
    [&mut episode.slip_true_mm_s, &mut episode.slip_fraction, &mut episode.displacement_mm]
        .map(|truth| truth.as_mut().unwrap())
}

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
fn later_frames_and_samples_change_no_earlier_prediction() {
    let (whole, predictions) = &*WHOLE;
    let onset = whole.label.as_ref().unwrap().iter().position(|&class| class == 2).unwrap();
    // The rig's vibration is generated anew from the recipe of the whole episode; see the next test.
    for name in names().filter(|name| !RECIPE_ALONE.contains(name)) {
        for frames in [1, 200, onset, onset + 3] {
            let part = &predict(name, &[&cut(whole, frames)])[0];
            let all = &predictions[name];
            assert_eq!(part.class, all.class[..frames], "{name}: classes of the first {frames} frames");
            assert_eq!(part.score, all.score[..frames], "{name}: scores of the first {frames} frames");
            assert_eq!(part.fallback, all.fallback[..frames], "{name}");
        }
    }
}

#[test]
fn detectors_of_untouched_fingers_use_nothing_but_the_recipe() {
    let (whole, predictions) = &*WHOLE;
    let mut other = whole.clone();
    other.xl.iter_mut().for_each(|xl| xl.fill([i16::MAX; 3]));
    other.piezo.iter_mut().for_each(|scan| *scan = PiezoFrame::zeroed());
    other.label = None;
    for name in RECIPE_ALONE {
        assert_eq!(predictions[name], predict(name, &[&other])[0]);
    }
    assert_ne!(predictions["rig-only"], predictions["idle-noise"]);
}

#[test]
fn state_goes_on_from_episode_to_episode() {
    let first = cut(&WHOLE.0, 900);
    let second = Episode { meta: first.meta.clone(), ..cut(&generated(4), 900) };
    let stream = joined(&first, &second);
    let mut carries = Vec::new();
    // The clock and the rig's recipe begin with each episode.
    for name in names().filter(|name| !RECIPE_ALONE.contains(name) && *name != "clock") {
        let apart = predict(name, &[&first, &second]);
        let whole = &predict(name, &[&stream])[0];
        assert_eq!(apart[1].score, whole.score[first.frames()..], "{name}: one recording or two episodes");
        assert_eq!(apart[1].class, whole.class[first.frames()..], "{name}");
        if predict(name, &[&second])[0].score != apart[1].score {
            carries.push(name);
        }
    }
    let expected = ["network", "network-alarm", "entropy", "mfcc-qda", "entropy-and-mfcc"];
    assert_eq!(carries, expected, "whose prediction depends on the episode before");
}

#[test]
fn classes_follow_from_score_threshold_and_fallback() {
    let (whole, predictions) = &*WHOLE;
    for (name, prediction) in predictions {
        assert_eq!(prediction.class.len(), whole.frames(), "{name}");
        assert!(prediction.score.iter().all(|score| score.is_finite()), "{name}");
        assert!(prediction.fallback.iter().all(|&class| class < 2), "{name}");
        assert_eq!(prediction.classes_at(prediction.threshold), prediction.class, "{name}");
    }
}

#[test]
fn without_arrays_the_network_says_what_contact_is() {
    let model = random_model(SMALL, 1).to_bytes().unwrap();
    let dead = Setup { model: &model, dead: Some(Modality::Piezo), ..setup() };
    let episode = cut(&generated(3), 720);
    for name in ["network", "network-alarm"] {
        let prediction = &predict_with(name, &dead, &[&episode])[0];
        assert!((0..=2).all(|class| prediction.class.contains(&class)), "{name}");
        assert_eq!(prediction.classes_at(prediction.threshold), prediction.class, "{name}");
    }
}

#[test]
fn one_and_three_sensors_and_a_change_between_them() {
    let platform = Platform::Tesollo;
    let episode =
        |sensors| generate(&Recipe { platform, sensors, seconds: Some(2.5), ..Recipe::new(6) }).unwrap();
    let (one, three) = (episode(1), episode(3));
    for name in names() {
        let both = predict(name, &[&one, &three]);
        assert_eq!(both[1], predict(name, &[&three])[0], "{name}: another number starts anew");
    }
}

#[test]
fn both_baselines_together_slip_where_each_does() {
    let slip = |name| WHOLE.1[name].class.iter().map(|&class| class == 2).collect::<Vec<_>>();
    let (a, b, both) = (slip("entropy"), slip("mfcc-qda"), slip("entropy-and-mfcc"));
    let count = |flags: &[bool]| flags.iter().filter(|&&flag| flag).count();
    assert_eq!(both, a.iter().zip(&b).map(|(&a, &b)| a && b).collect::<Vec<_>>());
    assert!(count(&both) > 0 && count(&both) < count(&a).min(count(&b)));
}

#[test]
fn contact_first_excludes_the_untouched_pad() {
    let contact_first = Fitted { class_order: ClassOrder::ContactFirst, ..FITTED.clone() };
    let (whole, predictions) = &*WHOLE;
    let a = &predictions["mfcc-qda"];
    let b = &predict_with("mfcc-qda", &Setup { fitted: &contact_first, ..setup() }, &[whole])[0];
    let mut excluded = 0;
    for frame in 0..whole.frames() {
        match b.fallback[frame] {
            0 => {
                assert_eq!(b.class[frame], 0);
                excluded += usize::from(a.class[frame] == 2);
            }
            _ => assert_eq!((a.class[frame], a.score[frame]), (b.class[frame], b.score[frame])),
        }
    }
    assert!(excluded > 0, "frames without contact that are slip if slip is decided first");
}

/// Power summed over the axes does not depend on the mounting: exchanged axes change no bit. Any other turn rounds its
/// samples to whole LSB again.
#[test]
fn the_mounting_of_the_accelerometers_does_not_matter() {
    // The rotation of the quaternion 1, 2, 3, 4, times 15.
    let turns = [[[0, 0, 15], [15, 0, 0], [0, 15, 0]], [[-10, 2, 11], [10, -5, 10], [5, 14, 2]]];
    let [exchanged, turned] = turns.map(|turn| {
        let mut episode = WHOLE.0.clone();
        for sample in episode.xl.iter_mut().flatten() {
            let before = sample.map(i32::from);
            *sample = turn.map(|row: [i32; 3]| {
                let lsb: i32 = row.iter().zip(before).map(|(a, b)| a * b).sum();
                (2 * lsb + 15).div_euclid(30).clamp(i16::MIN.into(), i16::MAX.into()) as i16
            });
        }
        predict("network", &[&episode]).remove(0)
    });
    let expected = &WHOLE.1["network"];
    assert!((&exchanged.class, &exchanged.score) == (&expected.class, &expected.score));
    let same = turned.class.iter().zip(&expected.class).filter(|(a, b)| a == b).count();
    println!("turned: the same class in {same} of {} frames", expected.class.len());
    assert!(same as f64 > 0.995 * expected.class.len() as f64);
}

/// `network-alarm` against the rule counted by hand from its scores of single frames.
#[test]
fn k_of_n_over_the_threshold_across_episodes() {
    let mut file = random_model(SMALL, 3);
    let mut predict_at = |name: &str, point: OperatingPoint, episodes: &[&Episode]| {
        file.point = point;
        predict_with(name, &Setup { model: &file.to_bytes().unwrap(), ..setup() }, episodes)
    };
    let episodes = [&cut(&WHOLE.0, 720), &cut(&generated(4), 720)];
    let by_frame = predict_at("network-alarm", OperatingPoint::EVEN, &episodes);
    let margins: Vec<f32> = by_frame.iter().flat_map(|prediction| prediction.score.clone()).collect();
    // A threshold in the middle of the margins of this network of random weights.
    let mut sorted: Vec<f32> = margins.iter().copied().filter(|&margin| margin != NEVER).collect();
    sorted.sort_by(f32::total_cmp);
    let threshold = Logit::from_bits((sorted[sorted.len() / 2] * 1024.0) as i32);
    for (k, n) in [(1, 1), (2, 3), (5, 8), (20, 32)] {
        let by_alarm = predict_at("network-alarm", OperatingPoint { threshold, k, n }, &episodes);
        let classes: Vec<u8> = by_alarm.iter().flat_map(|prediction| prediction.class.clone()).collect();
        let mut slips = 0;
        for frame in 0..margins.len() {
            let recent = &margins[(frame + 1).saturating_sub(n.into())..=frame];
            let over = recent.iter().filter(|&&margin| f64::from(margin) > threshold.to_f64()).count();
            assert_eq!(classes[frame] == 2, over >= usize::from(k), "{k} of {n}, frame {frame}");
            slips += usize::from(classes[frame] == 2);
        }
        assert!(slips > 0 && slips < margins.len(), "{k} of {n}: slip in {slips} frames");
        for prediction in by_alarm {
            assert_eq!(prediction.classes_at(prediction.threshold), prediction.class);
        }
    }
}

#[test]
fn bad_setups_are_refused_in_words() {
    let error = |name: &str, setup: Setup<'_>| match by_name(name, &setup) {
        Ok(_) => panic!("{name} was made"),
        Err(error) => format!("{error:#}"),
    };
    assert!(error("entropi", setup()).contains("there are: network, "));
    assert!(error("network", Setup { model: &MODEL[..100], ..setup() }).starts_with("model: "));
    let without = Fitted { rig_only: None, idle_noise: None, ..FITTED.clone() };
    for name in RECIPE_ALONE {
        let error = error(name, Setup { fitted: &without, ..setup() });
        assert_eq!(error, format!("{name}: was not fitted: the training episodes carried no recipe"));
    }

    let mut recorded = WHOLE.0.clone();
    recorded.meta.other.remove("recipe");
    recorded.slip_true_mm_s = None;
    for (name, missing) in [("rig-only", "recipe"), ("idle-noise", "recipe"), ("oracle", "slip_true")] {
        let error = by_name(name, &setup()).unwrap()(&recorded).unwrap_err();
        assert!(error.to_string().contains(missing), "{error}");
    }
}

#[test]
fn a_damaged_file_of_fitted_numbers_is_refused() {
    type Damage = (fn(&mut Fitted), &'static str);
    let damages: [Damage; 6] = [
        (|f| f.format += 1, "format"),
        (|f| f.data.split = "val".into(), "split"),
        (|f| f.clock[3][0] += 1, "clock"),
        (|f| f.entropy.std = 0.0, "entropy"),
        (|f| f.mfcc.scaling.std[2] = 0.0, "mfcc.scaling"),
        (|f| f.mfcc.slip.covariance[0][0] = -1.0, "positive definite"),
    ];
    for (damage, words) in damages {
        let mut damaged = FITTED.clone();
        damage(&mut damaged);
        let error = format!("{:#}", Fitted::from_json(&damaged.to_json().unwrap()).unwrap_err());
        assert!(error.contains(words), "{words}: {error}");
    }
    assert!(Fitted::from_json("{}").is_err());
    assert_eq!(Fitted::from_json(&FITTED.to_json().unwrap()).unwrap(), *FITTED, "unchanged, it is read back");
}

#[test]
fn fitting_repeats_itself_and_refuses_held_out_objects() {
    let base = Recipe { seconds: Some(5.0), scenario: ScenarioChoice::SixStep, ..Recipe::new(2) };
    let handle = |recipe: Recipe| Handle::Recipe { name: "this one".into(), recipe: Box::new(recipe) };
    let episodes: Vec<_> = base.series(4).into_iter().map(handle).collect();
    let plan = Plan { stride: 4, class_order: ClassOrder::SlipFirst };
    let run = || fit(&episodes, &[], "test", plan, || ()).unwrap();
    assert_eq!(run(), run());
    let held_out = [handle(Recipe { object: ObjectChoice::HeldOut, ..base })];
    let error = format!("{:#}", fit(&held_out, &[], "test", plan, || ()).unwrap_err());
    assert!(error.starts_with("this one: ") && error.contains("held out"), "{error}");
}
