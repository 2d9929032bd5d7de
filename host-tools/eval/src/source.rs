//! Where the evaluated episodes come from, and how they are cut into streams.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use slipsense_recording::Episode;
use slipsense_synth::{Recipe, generate};

/// Streams that the episodes of an input are cut into. A detector carries its state from episode to
/// episode within a stream and starts anew with the next stream, so the number is fixed: results must
/// not depend on how many cores there are.
pub const STREAMS: usize = 8;

/// Episodes that are evaluated together and reported under one name.
#[derive(Clone, Debug)]
pub struct Input {
    /// In the report: the split's, or the folder's last part.
    pub name: String,
    /// In the order of the stream: by name.
    pub episodes: Vec<Handle>,
}

/// One episode that is not in memory yet.
#[derive(Clone, Debug)]
pub enum Handle {
    File(PathBuf),
    Recipe { name: String, recipe: Box<Recipe> },
}

impl Handle {
    /// Name of the episode: the file's, without folder and extension.
    pub fn name(&self) -> String {
        match self {
            Self::File(path) => path.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            Self::Recipe { name, .. } => name.clone(),
        }
    }

    pub fn load(&self) -> Result<Episode> {
        match self {
            Self::File(path) => Ok(Episode::read(path)?),
            Self::Recipe { name, recipe } => generate(recipe).with_context(|| name.clone()),
        }
    }
}

impl Input {
    /// All `.npz` files of a folder, by name.
    pub fn folder(name: &str, folder: &Path) -> Result<Self> {
        let shown = folder.display();
        let files = || folder.read_dir()?.map(|entry| Ok(entry?.path())).collect::<io::Result<Vec<_>>>();
        let mut files = files().with_context(|| format!("{shown}: cannot read this folder"))?;
        files.retain(|path| path.extension().is_some_and(|extension| extension == "npz"));
        files.sort();
        if files.is_empty() {
            bail!("{shown}: holds no .npz file");
        }
        Ok(Self { name: name.to_owned(), episodes: files.into_iter().map(Handle::File).collect() })
    }

    /// Episodes to generate while they are evaluated.
    pub fn recipes(name: &str, recipes: Vec<(String, Recipe)>) -> Self {
        let handle = |(name, recipe)| Handle::Recipe { name, recipe: Box::new(recipe) };
        Self { name: name.to_owned(), episodes: recipes.into_iter().map(handle).collect() }
    }

    /// The streams, as ranges of `episodes`: contiguous, none empty, their lengths differ by at most one.
    pub fn streams(&self) -> Vec<Range<usize>> {
        let (episodes, streams) = (self.episodes.len(), STREAMS.min(self.episodes.len()));
        (0..streams).map(|s| s * episodes / streams..(s + 1) * episodes / streams).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_cover_the_episodes_once_and_in_order() {
        for episodes in [0, 1, 7, 8, 9, 100] {
            let recipes = (0..episodes).map(|i| (i.to_string(), Recipe::new(i))).collect();
            let input = Input::recipes("x", recipes);
            let streams = input.streams();
            assert_eq!(streams.len(), STREAMS.min(episodes as usize));
            let all: Vec<usize> = streams.iter().cloned().flatten().collect();
            assert_eq!(all, (0..episodes as usize).collect::<Vec<_>>());
            assert!(streams.iter().all(|s| !s.is_empty()));
        }
    }
}
