//! temporary
use rayon::prelude::*;
use slipsense::net::Model;
use slipsense::net::model::Aligned;
use slipsense::pipeline::Pipeline;
use slipsense::sensor::SensorInput;
use slipsense::params::MAX_SENSORS;
use slipsense_model::target::targets;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED, tuning_disturbances};
use slipsense_synth::{Recipe, ScenarioChoice, Split, generate_set};
use std::io::Write;
fn main() {
    let args: Vec<String> = std::env::args().collect();
    let bytes = std::fs::read(&args[1]).unwrap();
    let mut words = vec![0u32; bytes.len().div_ceil(4)];
    bytemuck_cast(&mut words, &bytes);
    let model = {
        let (_, all, _) = unsafe { words.align_to::<u8>() };
        let all: &'static [u8] = unsafe { std::mem::transmute(&all[..bytes.len()]) };
        Model::parse(all).unwrap()
    };
    let _ = Aligned([0u8; 4]);
    let mut recipes: Vec<(String, Recipe)> = Vec::new();
    for spec in &args[3..] {
        let (name, count) = spec.split_once('=').unwrap();
        let count: usize = count.parse().unwrap();
        if name == "tuning" {
            recipes.extend(tuning_disturbances(count).into_iter().map(|(_, r)| (name.to_owned(), r)));
        } else if name == "anywhere_disturbed" {
            let set = EpisodeSet::first(Split::ValAnywhere, 77, count);
            recipes.extend(set.episodes.into_iter().map(|e| (name.to_owned(), Recipe { scenario: ScenarioChoice::Disturbances, seconds: Some(60.0), speed_mm_s: None, pull_angle_deg: None, ..e.recipe })));
        } else {
            let split: Split = name.parse().unwrap();
            let set = EpisodeSet::first(split, if split.frozen_episodes() > 0 { FROZEN_SEED } else { 9 }, count);
            recipes.extend(set.episodes.into_iter().map(|e| (name.to_owned(), e.recipe)));
        }
    }
    let plain: Vec<Recipe> = recipes.iter().map(|(_, r)| r.clone()).collect();
    let out = generate_set(&plain, |index, episode| {
        let label = episode.label.clone().unwrap();
        let target = targets(&episode, &label);
        let mut pipeline = Pipeline::new(model, episode.sensors).unwrap();
        let mut z = Vec::new();
        let mut class = Vec::new();
        for frame in 0..episode.frames() {
            let mut inputs = [SensorInput::default(); MAX_SENSORS];
            for (s, input) in inputs.iter_mut().take(episode.sensors).enumerate() {
                *input = SensorInput { piezo: Some(episode.piezo(frame, s)), xl: Some(episode.xl_batch(frame, s)), xl_end: episode.xl_end(frame, s) };
            }
            let o = pipeline.step(&inputs[..episode.sensors]);
            z.push(o.log_odds.map_or(-40000, |l| l.to_bits()));
            class.push(o.class as u8);
        }
        if index % 20 == 0 { eprintln!("{index}"); }
        (label, target.iter().map(|t| *t as u8).collect::<Vec<u8>>(), z, class)
    }).unwrap();
    let mut file = std::io::BufWriter::new(std::fs::File::create(&args[2]).unwrap());
    for ((name, recipe), (label, target, z, class)) in recipes.iter().zip(out) {
        writeln!(file, "{}", serde_json::json!({"set": name, "scenario": format!("{:?}", recipe.scenario), "label": label, "target": target, "z": z, "class": class})).unwrap();
    }
    let _ = (0..1).into_par_iter().count();
}
fn bytemuck_cast(words: &mut [u32], bytes: &[u8]) {
    for (i, b) in bytes.iter().enumerate() { words[i / 4] |= u32::from(*b) << (8 * (i % 4)); }
}
