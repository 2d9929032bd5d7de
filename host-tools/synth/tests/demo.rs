//! The demo episode in git is what its recipe makes, and shows what a demo must show.

use std::path::{Path, PathBuf};

use slipsense_recording::Episode;
use slipsense_synth::{Recipe, generate};

fn demo(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../cli/demo").join(name)
}

#[test]
fn the_recipe_makes_the_committed_episode() {
    let recipe: Recipe = serde_json::from_slice(&std::fs::read(demo("recipe.json")).unwrap()).unwrap();
    let made = generate(&recipe).unwrap();
    let committed = Episode::read(demo("episode.npz")).unwrap();
    assert_eq!(made.piezo, committed.piezo);
    assert_eq!(made.xl, committed.xl);
    // After the large arrays, whose difference nobody wants printed.
    assert_eq!(made, committed);
}

#[test]
fn it_is_small_held_out_and_holds_slip_grip_change_and_tap() {
    assert!(std::fs::metadata(demo("episode.npz")).unwrap().len() < 650_000);
    let episode = Episode::read(demo("episode.npz")).unwrap();
    assert_eq!(episode.sensors, 2);
    assert_eq!(episode.meta.other["held_out"], true);
    assert_eq!(episode.meta.other["synthetic"], true);
    let events = episode.meta.other["events"].as_array().unwrap();
    for name in ["grip_change", "tap", "move"] {
        assert!(events.iter().any(|e| e["name"] == name), "{name}");
    }
    let labels = episode.label.as_deref().unwrap();
    for class in 0..3 {
        assert!(labels.iter().filter(|&&l| l == class).count() >= 60, "class {class}");
    }
}
