//! Which episodes make a set: proportions, balance, groups of objects; split, seed and frames alone decide.

use std::collections::{BTreeMap, BTreeSet};

use super::schedule::episode_seed;
use super::*;
use crate::check::within;
use crate::draw::{Stream, stream};
use crate::families::Stage;
use crate::mix::{PROTOCOL, ScenarioChoice};
use crate::objects::{self, Group, of_group};
use crate::recipe::{ObjectChoice, Platform, Recipe, Region, SPEEDS_MM_S};
use crate::scenario::plan;
use crate::scenario::script::{PhaseKind, Script};
use crate::{generate, generate_set, plan_frames};

fn object(recipe: &Recipe) -> &str {
    match &recipe.object {
        ObjectChoice::Named(name) => name,
        // As it was before it was varied.
        ObjectChoice::Own(object) => {
            object.name.split_once("-varied-").map_or(&object.name, |(name, _)| name)
        }
        other => panic!("{other:?} is drawn, not named"),
    }
}

fn names(objects: impl Iterator<Item = &'static objects::Object>) -> BTreeSet<&'static str> {
    objects.map(|object| object.name.as_str()).collect()
}

fn objects_of(recipes: &[Recipe]) -> BTreeSet<&str> {
    recipes.iter().map(object).collect()
}

fn first(split: Split, seed: u64, count: usize) -> Vec<Recipe> {
    EpisodeSet::first(split, seed, count).episodes.into_iter().map(|episode| episode.recipe).collect()
}

fn counts<K: Ord>(keys: impl Iterator<Item = K>) -> BTreeMap<K, usize> {
    let mut counts = BTreeMap::new();
    keys.for_each(|key| *counts.entry(key).or_default() += 1);
    counts
}

fn spread<K>(counts: &BTreeMap<K, usize>) -> usize {
    counts.values().max().unwrap() - counts.values().min().unwrap()
}

fn slips(recipes: &[Recipe]) -> Vec<&Recipe> {
    recipes.iter().filter(|recipe| recipe.scenario == ScenarioChoice::SixStep).collect()
}

#[test]
fn small_sets_have_the_mix_too() {
    let weights: usize = PROTOCOL.iter().map(|(_, weight)| weight).sum();
    let all = first(Split::Train, 5, 60);
    for length in [10, 20, 33, 60] {
        for &(scenario, weight) in PROTOCOL {
            let count = all[..length].iter().filter(|recipe| recipe.scenario == scenario).count() as f64;
            let must = (length * weight) as f64 / weights as f64;
            within(format!("{scenario:?} of {length} episodes, proportion {must}"), count - must, -1.0..1.0);
        }
    }
}

/// What operating points are chosen on shares neither objects nor seeds with what they are tested on.
#[test]
fn tuning_sees_nothing_of_a_test() {
    let tuning: Vec<Recipe> = tuning_disturbances(80).into_iter().map(|(_, recipe)| recipe).collect();
    assert_eq!(objects_of(&tuning), names(of_group(Group::Val)));
    assert!(tuning.iter().all(|recipe| recipe.scenario == ScenarioChoice::Disturbances));
    let seeds: BTreeSet<u64> = tuning.iter().map(|recipe| recipe.seed).collect();
    assert_eq!(seeds.len(), tuning.len());
    for split in Split::ALL {
        let tested = first(split, 0, 80);
        assert!(tested.iter().all(|recipe| !seeds.contains(&recipe.seed)), "{split}");
    }
    assert_eq!(tuning_disturbances(3), tuning_disturbances(80)[..3]);
    let varied = tuning.iter().filter(|recipe| matches!(recipe.object, ObjectChoice::Own(_))).count();
    assert!((40..=53).contains(&varied), "{varied} of 80 have a varied object");
    for physics in 0..2 {
        let recipes: Vec<Recipe> = tuning.iter().skip(physics).step_by(2).cloned().collect();
        let times = counts(recipes.iter().map(object));
        assert_eq!(times.len(), 4, "the laboratory and the families have all");
        assert!(times.values().all(|&count| count == recipes.len() / 4), "{times:?}");
    }
    assert_eq!(plan_frames(&tuning[0]).unwrap(), 60 * 240);
}

#[test]
fn speeds_and_objects_take_turns() {
    for (split, count) in [(Split::Train, 120), (Split::UmiOod, 120), (Split::Val, 40), (Split::Tesollo2, 43)]
    {
        let recipes = first(split, 0, count);
        let slips = slips(&recipes);
        let speeds = counts(slips.iter().map(|recipe| recipe.speed_mm_s.unwrap() as u32));
        let per_object = counts(slips.iter().map(|recipe| object(recipe)));
        assert_eq!(speeds.len(), SPEEDS_MM_S.len(), "{split}");
        assert!(spread(&speeds) <= 2, "{split}: {speeds:?}");
        assert!(spread(&per_object) <= 1, "{split}: {per_object:?}");
    }
    // As soon as there can be, there is every pair of object and speed.
    let recipes = first(Split::UmiOod, 9, 100);
    let slips = slips(&recipes);
    let pairs: BTreeSet<_> = slips.iter().map(|r| (object(r), r.speed_mm_s.unwrap() as u32)).collect();
    let must = of_group(Group::HeldOut).count() * SPEEDS_MM_S.len();
    assert_eq!(pairs.len(), must.min(slips.len()));
}

#[test]
fn groups_of_objects_do_not_mix() {
    let all = BTreeMap::from(Split::ALL.map(|split| (split, first(split, 0, 120))));
    let get = |split| objects_of(&all[&split]);
    let held_out: BTreeSet<_> = names(of_group(Group::HeldOut));
    let (train, val) = (get(Split::Train), get(Split::Val));
    assert_eq!(train, get(Split::UmiId), "new grasps of the same objects");
    assert!(train.is_disjoint(&val) && train.is_disjoint(&held_out) && val.is_disjoint(&held_out));
    assert_eq!(train.len() + val.len() + held_out.len(), objects::CATALOGUE.len(), "each object has its use");
    for split in [Split::UmiOod, Split::Palm, Split::Tesollo2, Split::Tesollo3, Split::Free] {
        assert_eq!(get(split), held_out, "{split}");
    }
    assert!(get(Split::Noslip).is_disjoint(&train), "no trained object among the false alarms");
    for split in Split::ALL.into_iter().filter(|split| split.held_out_stages().is_some()) {
        let objects = get(split);
        match split {
            Split::TrainAnywhere => assert_eq!(objects, train),
            Split::ValAnywhere => assert_eq!(objects, val),
            _ => assert!(objects.is_disjoint(&train), "{split}"),
        }
        let stages = split.held_out_stages().unwrap();
        for recipe in &all[&split] {
            let held_out = |stage| recipe.family(stage) == recipe.clone().holding_out(stage).family(stage);
            let held_out: Vec<_> = Stage::ALL.into_iter().filter(|&stage| held_out(stage)).collect();
            assert_eq!(held_out, stages, "{split}");
        }
    }
}

#[test]
fn the_arrays_of_the_tests_are_older_than_those_of_training() {
    for split in Split::ALL {
        for Recipe { seed, age_months, .. } in first(split, 0, 40) {
            match (split.is_test(), age_months) {
                (true, Some(months)) => assert!((4.0..=8.0).contains(&months), "{split}: {months}"),
                (false, None) => (),
                _ => panic!("{split}: {seed} of {age_months:?} months"),
            }
        }
    }
}

/// The sum of a pad's pressures is the force on it, whatever touches: "train pressure distribution covers test" in the
/// paper. By the plans alone, while something is held.
#[test]
fn training_grips_as_gently_and_as_firmly_as_the_tests() {
    const FROM_N: [f64; 7] = [0.1, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
    let histogram = |split: Split| -> Vec<f64> {
        let held = |recipe: Recipe| {
            let resolved = recipe.resolve().unwrap();
            let rng = |of| stream(recipe.seed, of, 0);
            let script = Script::draw(&mut rng(Stream::Script), &resolved);
            let plan = plan(&mut rng(Stream::Scenario), &resolved, script);
            plan.timeline.grip_n.into_iter().filter(|&n| n >= FROM_N[0]).step_by(100).collect::<Vec<_>>()
        };
        let forces: Vec<f64> = first(split, 0, 120).into_iter().flat_map(held).collect();
        let share = |bin: usize| {
            let is_in = |&&n: &&f64| n >= FROM_N[bin] && FROM_N.get(bin + 1).is_none_or(|&end| n < end);
            forces.iter().filter(is_in).count() as f64 / forces.len() as f64
        };
        (0..FROM_N.len()).map(share).collect()
    };
    let train = histogram(Split::Train);
    println!("held with, N, from {FROM_N:?}: {train:.3?} of the time in train");
    for split in [Split::UmiId, Split::UmiOod, Split::Palm, Split::Tesollo2, Split::Tesollo3, Split::Free] {
        let test = histogram(split);
        println!("{split}: {test:.3?}");
        for (bin, (train, test)) in train.iter().zip(test).enumerate() {
            within(
                format!("{split}, from {} N: train over test", FROM_N[bin]),
                (train + 0.005) / (test + 0.005),
                0.5..,
            );
        }
    }
}

#[test]
fn hands_regions_and_sensors() {
    for split in Split::ALL {
        let recipes = first(split, 3, 24);
        let tesollo = recipes.iter().filter(|recipe| recipe.platform == Platform::Tesollo).count();
        let sensors: BTreeSet<_> = recipes.iter().map(|recipe| recipe.sensors).collect();
        match split {
            Split::Tesollo2 => assert_eq!((tesollo, sensors), (24, [2].into())),
            Split::Tesollo3 => assert_eq!((tesollo, sensors), (24, [3].into())),
            Split::Noslip => assert_eq!((tesollo, sensors), (12, [2, 3].into())),
            Split::TrainAnywhere => assert_eq!((tesollo, sensors), (12, [2].into())),
            _ if split.held_out_stages().is_some() => assert_eq!((tesollo, sensors), (12, [2, 3].into())),
            _ => assert_eq!((tesollo, sensors), (0, [2].into())),
        }
        let palm = recipes.iter().all(|recipe| recipe.region == Region::Palm);
        assert_eq!(palm, split == Split::Palm);
        assert!(recipes.iter().all(|recipe| recipe.rig_leak == (split != Split::UmiQuiet)));
        let off_the_rig = matches!(split, Split::Noslip | Split::Free | Split::TransferNoslip);
        assert_eq!(slips(&recipes).is_empty(), off_the_rig, "{split}");
    }
}

#[test]
fn the_free_split_pulls_all_ways_and_twists() {
    let recipes = first(Split::Free, 0, Split::Free.frozen_episodes());
    let of = |scenario| recipes.iter().filter(|recipe| recipe.scenario == scenario).count();
    use ScenarioChoice::{FreeGrasp, FreePull, Rotation};
    assert_eq!([FreePull, Rotation, FreeGrasp].map(of), [40, 32, 8]);
    assert!(recipes.iter().all(|r| r.pull_angle_deg.is_some() == (r.scenario == ScenarioChoice::FreePull)));
    let angles = counts(recipes.iter().filter_map(|recipe| recipe.pull_angle_deg).map(|deg| deg as i32));
    let all: BTreeSet<i32> = (-5..=6).map(|step| 30 * step).collect();
    assert_eq!(angles.keys().copied().collect::<BTreeSet<_>>(), all);
    assert_eq!(angles[&0], 10, "the rig's way by hand");
    let others: BTreeSet<usize> = angles.iter().filter(|(deg, _)| **deg != 0).map(|(_, n)| *n).collect();
    assert_eq!(others, [2, 3].into(), "equally often");
}

#[test]
fn the_quiet_split_repeats_the_two_it_is_compared_with() {
    let quiet = first(Split::UmiQuiet, 7, 30);
    let loud = |split| first(split, 7, 15).into_iter().map(|recipe| Recipe { rig_leak: false, ..recipe });
    let pairs: Vec<_> = loud(Split::UmiId).zip(loud(Split::UmiOod)).flat_map(|(id, ood)| [id, ood]).collect();
    assert_eq!(quiet, pairs);
}

#[test]
fn no_two_episodes_share_a_seed() {
    let mut seen = BTreeSet::new();
    let mut total = 0;
    for split in Split::PAPER {
        for seed in [0, 1, u64::MAX] {
            let seeds: Vec<u64> = first(split, seed, 70).into_iter().map(|recipe| recipe.seed).collect();
            assert!(seeds.iter().all(|&seed| seed < 1 << 53), "a JSON number");
            total += seeds.len();
            seen.extend(seeds);
        }
    }
    assert_eq!(seen.len(), total);
}

/// By `printf slipsense/umi_ood/3/41 | sha256sum`: the first 16 digits without their last 11 bits.
#[test]
fn seeds_follow_the_written_rule() {
    assert_eq!(episode_seed(Split::UmiOod, 3, 41), 0xc366_8284_ab7d_911f >> 11);
}

#[test]
fn frames_decide_where_a_set_ends_and_a_larger_set_begins_with_the_smaller() {
    let set = EpisodeSet::new(Split::Train, 2, 30_000);
    let frames: Vec<usize> = set.episodes.iter().map(|episode| episode.frames).collect();
    let (last, before) = frames.split_last().unwrap();
    let before: usize = before.iter().sum();
    assert!(before < 30_000 && before + last >= 30_000);
    let train = |seed, frames| EpisodeSet::new(Split::Train, seed, frames);
    assert!(set.episodes.starts_with(&train(2, 5_000).episodes));
    assert_eq!(EpisodeSet::first(Split::Train, 2, 7), train(2, frames[..7].iter().sum()));
    assert_ne!(train(3, 5_000).episodes[0].recipe, set.episodes[0].recipe);
    assert!(train(0, 0).episodes.is_empty());
}

#[test]
fn the_paper_sized_set() {
    let sets = paper_set(0, PAPER_FRAMES);
    let total: usize = sets.iter().map(EpisodeSet::total_frames).sum();
    assert_eq!(sets[0].split, Split::Train);
    within("share of train", sets[0].total_frames() as f64 / total as f64, 0.25..);
    let last = sets[0].episodes.last().unwrap().frames;
    assert!((PAPER_FRAMES..PAPER_FRAMES + last).contains(&total), "{total} frames");
    assert_eq!(sets.iter().map(|set| set.split).collect::<BTreeSet<_>>(), Split::PAPER.into());
}

#[test]
fn names_of_splits() {
    for split in Split::ALL {
        assert_eq!(split.to_string().parse::<Split>().unwrap(), split);
        assert_eq!(serde_json::to_string(&split).unwrap(), format!("\"{split}\""));
    }
    let error = "umi".parse::<Split>().unwrap_err().to_string();
    assert!(error.contains("\"umi\" is not a split") && error.contains("umi_ood"), "{error}");
}

#[test]
fn sets_as_text() {
    let set = EpisodeSet::first(Split::Val, 4, 3);
    let text = set.to_text();
    assert_eq!(EpisodeSet::parse(&text).unwrap(), set);
    assert_eq!(text.lines().count(), 5, "a line for each episode: {text}");
    for (other, difference) in [
        (EpisodeSet { seed: 5, ..set.clone() }, "`seed` is 4, not 5"),
        (EpisodeSet { frames: 9, ..set.clone() }, "`frames` is"),
        (EpisodeSet { generator: 99, ..set.clone() }, "`generator` is"),
        (
            EpisodeSet { episodes: set.episodes[..2].to_vec(), ..set.clone() },
            "`number of episodes` is 3, not 2",
        ),
    ] {
        let found = set.difference(&other).unwrap();
        assert!(found.contains(difference), "{found}");
    }
    let mut other = set.clone();
    other.episodes[1].recipe.noise = 0.5;
    assert_eq!(set.difference(&other).unwrap(), "`recipe of val-00001` is another");
    assert_eq!(set.difference(&set), None);
}

/// Every part of the content counts, and nothing else.
#[test]
fn the_content_hash_sees_every_array() {
    let episode = generate(&Recipe { seconds: Some(2.5), sensors: 1, ..Recipe::new(8) }).unwrap();
    let hash = content_hash(&episode);
    assert_eq!(hash.len(), 64);
    let mut other = episode.clone();
    other.meta.other.insert("note".into(), "moved to another folder".into());
    assert_eq!(content_hash(&other), hash, "notes are not content");
    type Change = fn(&mut slipsense_recording::Episode);
    let changes: [(&str, Change); 9] = [
        ("piezo", |e| e.piezo.swap(0, 400)),
        ("xl", |e| e.xl[0][77][1] ^= 1),
        ("xl_end", |e| e.xl_end[3] += 1),
        ("label", |e| e.label.as_mut().unwrap()[9] ^= 1),
        ("slip_true", |e| e.slip_true_mm_s.as_mut().unwrap()[9] += 1.0),
        ("slip_fraction", |e| e.slip_fraction = None),
        ("displacement_mm", |e| e.displacement_mm.as_mut().unwrap()[0] += 0.02),
        ("xl_lsb_g", |e| e.meta.xl_lsb_g *= 2.0),
        ("recipe", |e| e.meta.other["recipe"]["seed"] = 9.into()),
    ];
    let mut hashes = BTreeSet::from([hash.clone()]);
    for (what, change) in changes {
        let mut other = episode.clone();
        change(&mut other);
        assert!(hashes.insert(content_hash(&other)), "{what} is content");
    }
    assert_ne!(set_hash(["a", "b"]), set_hash(["b", "a"]));
}

fn pulls_that_slip(split: Split) -> usize {
    let pulls = |recipe: &Recipe| {
        let resolved = recipe.resolve().unwrap();
        let script = Script::draw(&mut stream(recipe.seed, Stream::Script, 0), &resolved);
        if resolved.slips() { script.phases_of(PhaseKind::Pull).count() } else { 0 }
    };
    let set = EpisodeSet::first(split, FROZEN_SEED, split.frozen_episodes());
    set.episodes.iter().map(|episode| pulls(&episode.recipe)).sum()
}

#[test]
fn the_test_splits_slip_as_often_as_the_papers() {
    let umi = [Split::UmiId, Split::UmiOod].map(pulls_that_slip);
    let transfer = [Split::Palm, Split::Tesollo2, Split::Tesollo3].map(pulls_that_slip);
    assert!(umi.iter().all(|&slips| slips >= 84) && umi[0] + umi[1] >= 167);
    assert!(transfer.iter().all(|&slips| slips > 30));
    assert_eq!(pulls_that_slip(Split::Noslip), 0);
    assert!(pulls_that_slip(Split::Free) >= 72);
}

fn frozen() -> impl Iterator<Item = FrozenSet> {
    Split::ALL
        .into_iter()
        .filter(|split| split.frozen_episodes() > 0)
        .map(|split| split.frozen().expect("a manifest that is not damaged"))
}

#[test]
fn frozen_recipes_are_those_of_the_splits() {
    let sets = frozen().map(|frozen| {
        let today = EpisodeSet::new(frozen.split, frozen.seed, frozen.frames);
        assert_eq!(frozen.set().difference(&today), None, "{}", frozen.split);
    });
    assert_eq!(sets.count(), Split::ALL.len() - 2, "all but the two of training");
}

/// The shortest episode of every split and of every scenario on every hand; the example `freeze` compares all.
#[test]
fn a_sample_has_the_frozen_content() {
    let mut episodes: Vec<_> =
        frozen().flat_map(|set| set.episodes.into_iter().map(move |e| (set.split, e))).collect();
    episodes.sort_by_key(|(_, episode)| episode.frames);
    let (mut splits, mut kinds) = (BTreeSet::new(), BTreeSet::new());
    episodes.retain(|(split, FrozenEpisode { recipe: r, .. })| {
        let kind = format!("{:?} {:?}", r.scenario, r.platform);
        splits.insert(*split) | kinds.insert(kind)
    });
    assert_eq!(splits.len(), Split::ALL.len() - 2);
    let recipes: Vec<_> = episodes.iter().map(|(_, episode)| episode.recipe.clone()).collect();
    let made = generate_set(&recipes, |_, episode| (episode.frames(), content_hash(&episode))).unwrap();
    for ((_, frozen), (frames, hash)) in episodes.iter().zip(made) {
        assert_eq!((frames, &hash), (frozen.frames, &frozen.hash), "{}", frozen.name);
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
