//! A set of episodes before it is made, and the text that describes it.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::schedule::Schedule;
use super::split::{GENERATOR_VERSION, PAPER_FRAMES, SetError, Split};
use crate::generate::plan_frames;
use crate::recipe::Recipe;

/// Version of the text of set descriptions and manifests.
pub const FORMAT: u32 = 1;

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannedEpisode {
    /// Split and index, `umi_id-00042`; the file is called so with `.npz` behind.
    pub name: String,
    pub frames: usize,
    pub recipe: Recipe,
}

/// A set of episodes, as in `set.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeSet {
    pub format: u32,
    /// [`GENERATOR_VERSION`] that made it.
    pub generator: u32,
    pub split: Split,
    pub seed: u64,
    /// Frames asked for; the set ends with the episode that reaches them.
    pub frames: usize,
    /// The episodes in order. Last, so that the text can have a line for each.
    pub episodes: Vec<PlannedEpisode>,
}

impl EpisodeSet {
    /// The set of a split and seed that has `frames` frames at least, at most one episode more.
    pub fn new(split: Split, seed: u64, frames: usize) -> Self {
        let mut set = Self::empty(split, seed, frames);
        set.extend(|_, made| made < frames);
        set
    }

    /// The first `count` episodes of a split and seed; `frames` is what they have together, so that
    /// [`EpisodeSet::new`] makes the same set from it.
    pub fn first(split: Split, seed: u64, count: usize) -> Self {
        let mut set = Self::empty(split, seed, 0);
        set.extend(|episodes, _| episodes < count);
        set.frames = set.total_frames();
        set
    }

    fn empty(split: Split, seed: u64, frames: usize) -> Self {
        Self { format: FORMAT, generator: GENERATOR_VERSION, split, seed, frames, episodes: Vec::new() }
    }

    /// Add episodes as long as `more` says so of the episodes and frames there are.
    fn extend(&mut self, more: impl Fn(usize, usize) -> bool) {
        let schedule = Schedule::new(self.split, self.seed);
        let mut made = 0;
        while more(self.episodes.len(), made) {
            let index = self.episodes.len();
            let recipe = schedule.recipe(index);
            let frames = plan_frames(&recipe).expect("what a schedule makes can be generated");
            self.episodes.push(PlannedEpisode { name: name(self.split, index), frames, recipe });
            made += frames;
        }
    }

    pub fn total_frames(&self) -> usize {
        self.episodes.iter().map(|episode| episode.frames).sum()
    }

    /// Read the text of [`EpisodeSet::to_text`]; the error names field and rule.
    pub fn parse(text: &str) -> Result<Self, SetError> {
        let set: Self = parse(text)?;
        let names = set.episodes.iter().map(|episode| episode.name.as_str());
        check(set.format, set.split, names)?;
        Ok(set)
    }

    /// JSON with one line for each episode, the same for the same set.
    pub fn to_text(&self) -> String {
        to_text(&Self { episodes: Vec::new(), ..self.clone() }, &self.episodes)
    }

    /// The first thing in which this set differs from another: its name, ours and theirs.
    pub fn difference(&self, other: &Self) -> Option<String> {
        let differs = |what: &str, ours: &dyn ToString, theirs: &dyn ToString| {
            let (ours, theirs) = (ours.to_string(), theirs.to_string());
            (ours != theirs).then(|| format!("`{what}` is {ours}, not {theirs}"))
        };
        let header = differs("format", &self.format, &other.format)
            .or_else(|| differs("generator", &self.generator, &other.generator))
            .or_else(|| differs("split", &self.split, &other.split))
            .or_else(|| differs("seed", &self.seed, &other.seed))
            .or_else(|| differs("frames", &self.frames, &other.frames));
        let mut pairs = self.episodes.iter().zip(&other.episodes);
        header
            .or_else(|| {
                let (ours, theirs) = pairs.find(|(ours, theirs)| ours != theirs)?;
                differs(&format!("frames of {}", ours.name), &ours.frames, &theirs.frames)
                    .or_else(|| Some(format!("`recipe of {}` is another", ours.name)))
            })
            .or_else(|| differs("number of episodes", &self.episodes.len(), &other.episodes.len()))
    }
}

fn name(split: Split, index: usize) -> String {
    format!("{split}-{index:05}")
}

/// Check what the types of a set's text leave open.
pub(super) fn check<'a>(
    format: u32,
    split: Split,
    names: impl ExactSizeIterator<Item = &'a str>,
) -> Result<(), SetError> {
    if format != FORMAT {
        return Err(SetError::new(format!("`format` is {format}, must be {FORMAT}")));
    }
    if names.len() == 0 {
        return Err(SetError::new("`episodes` is empty, must hold at least one"));
    }
    for (index, found) in names.enumerate() {
        let must = name(split, index);
        if found != must {
            return Err(SetError::new(format!(
                "`episodes[{index}].name` is \"{found}\", must be \"{must}\""
            )));
        }
    }
    Ok(())
}

pub(super) fn parse<T: DeserializeOwned>(text: &str) -> Result<T, SetError> {
    serde_json::from_str(text).map_err(|error| SetError::new(format!("is damaged: {error}")))
}

/// JSON of a description whose last field is an empty list, with one line for each of `episodes` in it.
pub(super) fn to_text(header: &impl Serialize, episodes: &[impl Serialize]) -> String {
    let json = |value| serde_json::to_string(value).expect("numbers and names are JSON");
    let header = serde_json::to_string(header).expect("numbers and names are JSON");
    let lines: Vec<String> = episodes.iter().map(json).collect();
    let start = header.strip_suffix("]}").expect("the list of episodes comes last");
    format!("{start}\n{}\n]}}\n", lines.join(",\n"))
}

/// The paper-sized set, scaled to `frames` frames in all: the test splits in fixed numbers of episodes
/// ([`Split::paper_episodes`]), `train` what is left. With [`PAPER_FRAMES`] and the frozen seed the test
/// splits are the frozen ones, `noslip` the first minutes of it.
pub fn paper_set(seed: u64, frames: usize) -> Vec<EpisodeSet> {
    let scaled = |split: Split| (split.paper_episodes() * frames).div_ceil(PAPER_FRAMES);
    let tests: Vec<_> = Split::PAPER
        .into_iter()
        .filter(|&split| split != Split::Train)
        .map(|split| EpisodeSet::first(split, seed, scaled(split)))
        .collect();
    let left = frames.saturating_sub(tests.iter().map(EpisodeSet::total_frames).sum()).max(1);
    std::iter::once(EpisodeSet::new(Split::Train, seed, left)).chain(tests).collect()
}
