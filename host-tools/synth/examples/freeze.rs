//! Write the manifests of the frozen test sets, or check them:
//! `cargo run --release -p slipsense-synth --example freeze -- [--check] [--episodes N] [SPLIT...]`.
//!
//! Without names all test splits. `--check` makes every episode of the committed manifests and compares,
//! and refuses sets of another size than the splits say. `--episodes N` freezes no more than N episodes of
//! each, while the generator still changes.

use std::error::Error;
use std::fs;
use std::path::PathBuf;

use indicatif::{ProgressBar, ProgressStyle};
use slipsense_synth::labels::SLIP;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED, FrozenSet};
use slipsense_synth::{Recipe, Split, content_hash, generate_set};

fn main() -> Result<(), Box<dyn Error>> {
    let (mut check, mut most, mut splits) = (false, usize::MAX, Vec::new());
    let mut args = std::env::args().skip(1);
    while let Some(arg) = args.next() {
        match arg.as_str() {
            "--check" => check = true,
            "--episodes" => most = args.next().ok_or("--episodes needs a number")?.parse()?,
            name => splits.push(name.parse::<Split>()?),
        }
    }
    if splits.is_empty() {
        splits.extend(Split::ALL.into_iter().filter(|split| split.frozen_episodes() > 0));
    }
    for split in splits {
        let count = split.frozen_episodes();
        if count == 0 {
            return Err(format!("{split}: no set of this split is frozen").into());
        }
        let set = EpisodeSet::first(split, FROZEN_SEED, count.min(most));
        let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(format!("frozen/{split}.json"));
        let made = freeze(set)?;
        println!(
            "{split}: {} episodes, {} frames, {} slip events",
            made.episodes.len(),
            made.frames,
            made.slip_events
        );
        if check {
            compare(&made, &FrozenSet::parse(&fs::read_to_string(&path)?)?)
                .map_err(|rule| format!("{}: {rule}", path.display()))?;
        } else {
            fs::write(&path, made.to_text())?;
        }
    }
    Ok(())
}

fn freeze(set: EpisodeSet) -> Result<FrozenSet, Box<dyn Error>> {
    let style = ProgressStyle::with_template("{msg} [{bar:40}] {pos}/{len} {eta}")?;
    let bar = ProgressBar::new(set.episodes.len() as u64).with_style(style).with_message(set.split.name());
    let recipes: Vec<Recipe> = set.episodes.iter().map(|episode| episode.recipe.clone()).collect();
    let made = generate_set(&recipes, |_, episode| {
        bar.inc(1);
        let label = episode.label.as_deref().unwrap_or(&[]);
        let slips = label.chunk_by(|a, b| a == b).filter(|run| run[0] == SLIP).count();
        (content_hash(&episode), slips)
    })?;
    bar.finish_and_clear();
    let (hashes, slips): (Vec<_>, Vec<usize>) = made.into_iter().unzip();
    Ok(FrozenSet::new(set, hashes, slips.iter().sum()))
}

fn compare(made: &FrozenSet, frozen: &FrozenSet) -> Result<(), String> {
    if let Some(difference) = frozen.set().difference(&made.set()) {
        return Err(difference);
    }
    let mut pairs = frozen.episodes.iter().zip(&made.episodes);
    match pairs.find(|(old, new)| old.hash != new.hash) {
        Some((old, _)) => Err(format!("content of {} is another", old.name)),
        None if frozen.slip_events != made.slip_events => Err("`slip_events` is another".into()),
        None => Ok(()),
    }
}
