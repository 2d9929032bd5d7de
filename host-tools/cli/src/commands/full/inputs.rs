//! What `SPLIT_OR_DIR` on the command line means, and how much of a split.

use std::path::Path;

use anyhow::{Result, bail, ensure};
use slipsense::params::FRAME_RATE_HZ;
use slipsense_eval::source::Input;
use slipsense_synth::Split;
use slipsense_synth::splits::{EpisodeSet, FROZEN_SEED};

use crate::summary::file_name;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Frames {
    /// Of which split; of all that have none of their own if `None`.
    split: Option<Split>,
    frames: usize,
}

/// Most frames of one split: the truths and verdicts of 100 hours fill some GB of memory.
const FRAMES_MAX: usize = 100 * 3600 * FRAME_RATE_HZ as usize;

impl Frames {
    /// Read `N` or `SPLIT=N`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (split, number) = match text.split_once('=') {
            Some((split, number)) => (Some(split.parse::<Split>().map_err(|e| e.to_string())?), number),
            None => (None, text),
        };
        match number.parse() {
            Ok(frames @ 1..=FRAMES_MAX) => Ok(Self { split, frames }),
            _ => Err(format!("N must be 1 to {FRAMES_MAX}")),
        }
    }
}

/// The episodes of folders, or of splits, to be generated while they are used: frozen sets, or as many frames as
/// `frames` says. A split is looked for in `data` first. No two may have one name.
pub fn inputs(named: &[String], data: Option<&Path>, frames: &[Frames]) -> Result<Vec<Input>> {
    check_frames(named, frames)?;
    let inputs = named.iter().map(|name| input(name, data, frames)).collect::<Result<Vec<Input>>>()?;
    for (i, input) in inputs.iter().enumerate() {
        let twice = inputs[..i].iter().any(|other| other.name == input.name);
        ensure!(!twice, "two inputs are called {}; rename one", input.name);
    }
    Ok(inputs)
}

/// No split twice, and only of splits that are inputs.
fn check_frames(named: &[String], frames: &[Frames]) -> Result<()> {
    for (i, Frames { split, .. }) in frames.iter().enumerate() {
        let of = split.map_or("all splits".to_owned(), |split| split.to_string());
        ensure!(frames[..i].iter().all(|other| other.split != *split), "--frames: given twice for {of}");
        let is_input = split.is_none_or(|split| named.iter().any(|input| input == split.name()));
        ensure!(is_input, "--frames: {of} is not among the inputs");
    }
    Ok(())
}

/// Frames asked for of a split; `None` for its frozen set.
fn frames_of(split: Split, frames: &[Frames]) -> Option<usize> {
    let of = |wanted: Option<Split>| frames.iter().find(|frames| frames.split == wanted);
    of(Some(split)).or_else(|| of(None)).map(|frames| frames.frames)
}

/// A folder has the frames that it has.
fn refuse_frames(input: &str, frames: &[Frames]) -> Result<()> {
    if frames.iter().any(|frames| frames.split.is_none_or(|split| split.name() == input)) {
        bail!("--frames: {input} is a folder; only splits can be generated (SPLIT=N for one of several)");
    }
    Ok(())
}

fn input(input: &str, data: Option<&Path>, frames: &[Frames]) -> Result<Input> {
    if let Some(data) = data {
        ensure!(data.is_dir(), "--data {}: no such folder, looked for {input} in it", data.display());
        if data.join(input).is_dir() {
            refuse_frames(input, frames)?;
            return Input::folder(input, &data.join(input));
        }
    }
    let folder = Path::new(input);
    if !folder.exists() {
        if let Ok(split) = input.parse::<Split>() {
            let set = match frames_of(split, frames) {
                Some(frames) => EpisodeSet::new(split, FROZEN_SEED, frames),
                None => split.frozen()?.set(),
            };
            return Ok(Input::recipes(input, set.episodes.into_iter().map(|e| (e.name, e.recipe)).collect()));
        }
        let names = Split::ALL.map(Split::name).join(", ");
        bail!("{input}: no such folder, and no split ({names})");
    }
    refuse_frames(input, frames)?;
    Input::folder(&file_name(input), folder)
}
