//! The frozen test sets are what the generator makes today: recipes of all episodes, content of a sample.

use slipsense_synth::splits::{EpisodeSet, FrozenSet};
use slipsense_synth::{Split, content_hash, generate_set};

/// Test splits, which have a manifest.
fn frozen() -> impl Iterator<Item = FrozenSet> {
    Split::ALL
        .into_iter()
        .filter(|split| split.frozen_episodes() > 0)
        .map(|split| split.frozen().expect("a manifest that is not damaged"))
}

#[test]
fn recipes_are_those_of_the_splits() {
    let mut sets = 0;
    for frozen in frozen() {
        let today = EpisodeSet::new(frozen.split, frozen.seed, frozen.frames);
        assert_eq!(frozen.set().difference(&today), None, "{}", frozen.split);
        sets += 1;
    }
    assert_eq!(sets, Split::ALL.len() - 1);
}

/// First, last and one between; the whole sets are compared by the example `freeze`.
#[test]
fn a_sample_has_the_frozen_content() {
    for frozen in frozen() {
        let last = frozen.episodes.len() - 1;
        let sample = [0, last / 3, last].map(|index| &frozen.episodes[index]);
        let recipes = sample.map(|episode| episode.recipe.clone());
        let made = generate_set(&recipes, |_, episode| (episode.frames(), content_hash(&episode))).unwrap();
        for (episode, (frames, hash)) in sample.iter().zip(made) {
            assert_eq!(frames, episode.frames, "{}: frames", episode.name);
            assert_eq!(hash, episode.hash, "{}: content", episode.name);
        }
        println!("{}: {} as frozen", frozen.split, sample.map(|e| e.name.as_str()).join(", "));
    }
}

#[test]
fn damaged_manifests_are_refused_by_field() {
    let text = Split::Val.frozen().unwrap().to_text();
    assert_eq!(FrozenSet::parse(&text).unwrap(), Split::Val.frozen().unwrap(), "text and back");
    let frames = format!("\"frames\":{}", Split::Val.frozen().unwrap().frames);
    let first_hash = Split::Val.frozen().unwrap().episodes[0].hash.clone();
    for (from, to, rule) in [
        ("\"format\":1", "\"format\":7", "`format` is 7"),
        ("\"seed\":0,", "", "missing field `seed`"),
        ("\"split\":\"val\"", "\"split\":\"vale\"", "vale"),
        ("val-00001", "val-00003", "`episodes[1].name` is \"val-00003\""),
        (&frames, "\"frames\":12", "`frames` is 12"),
        (&first_hash, "0123", "`hash` of val-00000"),
        ("\n]}", "", "is damaged"),
    ] {
        assert!(text.contains(from), "{from} is in the manifest");
        let error = FrozenSet::parse(&text.replacen(from, to, 1)).unwrap_err().to_string();
        assert!(error.contains(rule) && error.lines().count() == 1, "{error:?} says {rule:?}");
    }
}
