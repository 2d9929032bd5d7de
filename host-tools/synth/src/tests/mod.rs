//! Whole episodes: what every test of them needs, the demo in git, and the same bits again.

mod families;
mod levels;
mod recipe;
mod scenarios;

use std::path::{Path, PathBuf};

use slipsense_recording::Episode;

use crate::check::{median, quantile, within};
use crate::*;

fn labels(e: &Episode) -> &[u8] {
    e.label.as_deref().unwrap()
}

fn count(e: &Episode, label: u8) -> usize {
    labels(e).iter().filter(|&&l| l == label).count()
}

fn demo(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/demo").join(name)
}

#[test]
fn the_recipe_of_the_demo_makes_the_committed_episode() {
    let recipe: Recipe = serde_json::from_slice(&std::fs::read(demo("recipe.json")).unwrap()).unwrap();
    let made = generate(&recipe).unwrap();
    let committed = Episode::read(demo("episode.npz")).unwrap();
    assert!(made.piezo == committed.piezo && made.xl == committed.xl);
    // After the large arrays, whose difference nobody wants printed.
    assert_eq!(made, committed);
}

#[test]
fn the_demo_is_small_held_out_and_holds_slip_grip_change_and_tap() {
    assert!(std::fs::metadata(demo("episode.npz")).unwrap().len() < 650_000);
    let episode = Episode::read(demo("episode.npz")).unwrap();
    let meta = &episode.meta.other;
    assert_eq!(episode.sensors, 2);
    assert_eq!((&meta["held_out"], &meta["synthetic"]), (&true.into(), &true.into()));
    let events = meta["events"].as_array().unwrap();
    for name in ["grip_change", "tap", "move"] {
        assert!(events.iter().any(|e| e["name"] == name), "{name}");
    }
    for class in 0..3 {
        assert!(count(&episode, class) >= 60, "class {class}");
    }
}

#[test]
fn the_same_recipe_gives_the_same_episode_and_another_seed_another() {
    for (platform, sensors) in [(Platform::Umi, 2), (Platform::Tesollo, 3)] {
        for vibration in [SourceFamily::Asperities, SourceFamily::Autoregressive] {
            let (scenario, seconds) = (ScenarioChoice::FreeGrasp, Some(3.0));
            let recipe = Recipe { platform, sensors, vibration, scenario, seconds, ..Recipe::new(5) };
            let (a, b) = (generate(&recipe).unwrap(), generate(&recipe).unwrap());
            a.validate().unwrap();
            assert!(a == b, "{platform:?}, {vibration:?}");
            let held = median(levels::of_label(&a, &levels::rms_mg(&a, 34), labels::NO_SLIP));
            within(format!("{platform:?}, {vibration:?}: held with sensor noise, mg"), held, 1.0..200.0);
            assert_ne!(generate(&Recipe { seed: 6, ..recipe }).unwrap().xl, a.xl);
        }
    }
}
