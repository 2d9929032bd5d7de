//! Turned accelerometer axes, by hand and on a detector that knows its axes.

use nalgebra::Matrix3;
use slipsense_synth::{Recipe, ScenarioChoice};

use super::*;
use crate::rotation::{KindResults, RotationResults, Turn, TurnKind, run};
use crate::source::Input;

#[test]
fn random_turns_are_rotations_and_follow_from_the_seed() {
    let turns = Turn::all(20, 3);
    let random: Vec<&Turn> = turns.iter().filter(|turn| turn.kind == TurnKind::Random).collect();
    assert_eq!(random.len(), 20);
    for turn in &random {
        for matrix in &turn.per_sensor {
            assert!((matrix * matrix.transpose() - Matrix3::identity()).norm() < 1e-12, "{}", turn.name);
            assert!((matrix.determinant() - 1.0).abs() < 1e-12, "no mirror image");
        }
        assert_ne!(turn.per_sensor[0], turn.per_sensor[1], "each sensor its own");
    }
    assert_eq!(turns, Turn::all(20, 3));
    assert_ne!(turns[0], Turn::all(20, 4)[0]);
    // Uniform: the mean over many is the zero matrix, and its mean square is a third.
    let many = Turn::all(4000, 1);
    let random: Vec<_> = many.iter().filter(|turn| turn.kind == TurnKind::Random).collect();
    let mean: Matrix3<f64> = random.iter().map(|turn| turn.per_sensor[0]).sum::<Matrix3<f64>>() / 4000.0;
    let square = random.iter().map(|turn| turn.per_sensor[0].map(|x| x * x)).sum::<Matrix3<f64>>() / 4000.0;
    assert!(mean.amax() < 0.04 && square.map(|x| x - 1.0 / 3.0).amax() < 0.02);
}

#[test]
fn exact_turns_move_samples_without_rounding() {
    let turns = Turn::all(0, 0);
    let at = |name: &str| turns.iter().find(|turn| turn.name == name).unwrap();
    assert_eq!(turns.len(), 5 + 7);
    assert_eq!(at("zxy").sample(0, [1, -2, 3]), ([3, 1, -2], false));
    assert_eq!(at("yxz").sample(2, [1, -2, 3]), ([-2, 1, 3], false));
    assert_eq!(at("-x+y-z").sample(1, [1, -2, 3]), ([-1, -2, -3], false));
    // The lowest value has no opposite.
    assert_eq!(at("-x+y+z").sample(0, [i16::MIN, 0, i16::MIN]), ([i16::MAX, 0, i16::MIN], true));
}

/// Compare a detector whose flag is a function of the first sample of each frame of the first sensor; every second
/// frame counts as touched.
fn compare(inputs: &[Input], slip: fn([i16; 3]) -> bool) -> RotationResults {
    let make = || -> anyhow::Result<Detector<'static>> {
        Ok(Box::new(move |episode| {
            let flag = |frame| f32::from(u8::from(slip(episode.xl_batch(frame, 0)[0])));
            let frames = 0..episode.frames();
            let fallback = frames.clone().map(|frame| u8::from(frame % 2 == 0)).collect();
            Ok(Prediction::new(frames.map(flag).collect(), 0.5, fallback))
        }))
    };
    run(inputs, &make, 4, 1, &|| ()).unwrap()
}

#[test]
fn dependence_on_the_axes_is_measured() {
    let recipe = Recipe { seconds: Some(2.5), scenario: ScenarioChoice::Disturbances, ..Recipe::new(4) };
    let recipes = vec![("a".to_owned(), recipe.clone()), ("b".to_owned(), Recipe { seed: 5, ..recipe })];
    let inputs = [Input::recipes("two", recipes)];
    let axis = compare(&inputs, |sample| sample[0] > 0);
    assert!(axis.synthetic && !axis.met);
    assert_eq!((axis.episodes, axis.frames, axis.touched_frames), (2, 1200, 600));
    let [random, permutations, flips] = &axis.kinds[..] else { panic!("three kinds") };
    assert_eq!((random.turns.len(), permutations.turns.len(), flips.turns.len()), (4, 5, 7));
    assert!(random.agree_share_min.unwrap() < 0.9);
    assert!(random.agree_share_min <= random.agree_share_mean);
    // The first axis stays what it is where only the others are exchanged or reversed.
    let share = |kind: &KindResults, name: &str| {
        kind.turns.iter().find(|turn| turn.name == name).unwrap().agree_share.unwrap()
    };
    assert_eq!((share(permutations, "xzy"), share(flips, "+x-y-z")), (1.0, 1.0));
    assert!(share(permutations, "yxz") < 0.95 && share(flips, "-x+y+z") < 0.5);

    // What only the power decides stays the same to the frame where nothing is rounded.
    let power =
        compare(&inputs, |sample| sample.iter().map(|&lsb| i64::from(lsb).pow(2)).sum::<i64>() % 2 == 0);
    let [random, permutations, flips] = &power.kinds[..] else { panic!("three kinds") };
    assert_eq!((permutations.agree_share_min, flips.agree_share_min), (Some(1.0), Some(1.0)));
    assert!(random.agree_share_min.unwrap() < 0.9, "rounding changes the last bit of a power");
    let text = power.to_string();
    assert!(
        text.contains("synthetic data") && text.contains("99.50 %") && text.contains("not met"),
        "{text}"
    );
}
