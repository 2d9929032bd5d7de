//! A folder that holds one set of episodes and fills up file by file, from any number of processes.
//!
//! `set.json` says which set it is and is written first. Episodes appear whole, so that a run that was
//! cut off goes on with those that are missing. When all are there, `hashes.json` says what they hold.

use std::path::{Path, PathBuf};
use std::{fs, io};

use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use slipsense_recording::Episode;
use slipsense_recording::npz::Reader;
use slipsense_synth::splits::{EpisodeSet, FrozenSet, SetHashes, recipe_of};
use slipsense_synth::{Shard, content_hash};

use crate::output::{is_partial, refuse_file, write_file};

const SET: &str = "set.json";
const HASHES: &str = "hashes.json";

#[derive(Debug)]
pub struct SetDir {
    pub path: PathBuf,
    pub set: EpisodeSet,
    /// Hash of each episode that was made just now.
    pub made: Vec<Option<String>>,
    /// All episodes are there, or none was to be made.
    pub is_complete: bool,
    hashes: Option<SetHashes>,
    frozen: Option<FrozenSet>,
}

impl SetDir {
    /// Check, and touch nothing, that this folder can hold this set: no other is there, and none is damaged.
    pub fn check(path: &Path, set: EpisodeSet) -> Result<Self> {
        refuse_file(path)?;
        if let Some(there) = read(&path.join(SET), EpisodeSet::parse)? {
            if let Some(difference) = there.difference(&set) {
                let file = path.join(SET);
                bail!("{}: {difference}; another set needs another folder", file.display());
            }
        } else if let Some(file) = episode_files(path)?.first() {
            bail!("{}: there are episodes but no {SET}; a set needs a folder of its own", file.display());
        }
        Self::with_hashes(path, set)
    }

    pub fn open(path: &Path) -> Result<Option<Self>> {
        let set = read(&path.join(SET), EpisodeSet::parse)?;
        set.map(|set| Self::with_hashes(path, set)).transpose()
    }

    fn with_hashes(path: &Path, set: EpisodeSet) -> Result<Self> {
        let hashes = read(&path.join(HASHES), |text| SetHashes::parse(text, &set))?;
        let frozen = match set.split.frozen_episodes() {
            0 => None,
            _ => Some(set.split.frozen()?).filter(|frozen| frozen.set() == set),
        };
        let made = vec![None; set.episodes.len()];
        Ok(Self { path: path.to_owned(), set, made, is_complete: true, hashes, frozen })
    }

    pub fn begin(&self) -> Result<()> {
        fs::create_dir_all(&self.path)
            .with_context(|| format!("{}: cannot write this folder", self.path.display()))?;
        let file = self.path.join(SET);
        if file.exists() { Ok(()) } else { write_file(&file, self.set.to_text()) }
    }

    /// Episodes of a part that are not there, or not whole.
    pub fn missing(&self, shard: Shard) -> Vec<usize> {
        (0..self.set.episodes.len()).filter(|&index| shard.has(index) && !self.is_there(index)).collect()
    }

    /// A look at the archive's directory, which stands at its end, and at the first array's shape.
    fn is_there(&self, index: usize) -> bool {
        let frames = Some(&self.set.episodes[index].frames);
        Reader::open(&self.file(index)).is_ok_and(|mut npz| {
            npz.has("meta") && npz.array::<u16>("piezo").is_ok_and(|piezo| piezo.shape().first() == frames)
        })
    }

    pub fn file(&self, index: usize) -> PathBuf {
        self.path.join(format!("{}.npz", self.set.episodes[index].name))
    }

    /// If all episodes are there, check the hashes that are known, and write them all down where that is not done.
    pub fn finish(&mut self, each: impl Fn(usize) + Sync) -> Result<()> {
        self.is_complete = self.missing(Shard::WHOLE).is_empty();
        if !self.is_complete {
            return Ok(());
        }
        let mut known = self.made.clone();
        if let Some(hashes) = &self.hashes {
            let stored = hashes.episodes.iter().map(|episode| &episode.hash);
            let differs = |(new, old): (&Option<String>, _)| new.as_ref().is_some_and(|new| new != old);
            if let Some(index) = known.iter().zip(stored).position(differs) {
                bail!("{}: differs from what {HASHES} says of it", self.file(index).display());
            }
        } else {
            let unknown: Vec<usize> = (0..known.len()).filter(|&index| known[index].is_none()).collect();
            for (index, hash) in self.read_hashes(&unknown, each)? {
                known[index] = Some(hash);
            }
            let hashes = SetHashes::new(&self.set, known.into_iter().flatten().collect());
            let file = self.path.join(HASHES);
            // Another shard that ended at the same time may have written it, and removed our temporary file.
            if let Err(error) = write_file(&file, hashes.to_text())
                && !file.exists()
            {
                return Err(error);
            }
            self.hashes = Some(hashes);
            // Left by runs that were cut off. No other shard is at work: everything is there.
            for entry in fs::read_dir(&self.path).into_iter().flatten().flatten() {
                if is_partial(&entry.path()) {
                    let _ = fs::remove_file(entry.path());
                }
            }
        }
        self.compare_with_frozen()
    }

    /// Compare every episode with `hashes.json` and, where this is one, with the frozen test set.
    pub fn verify(&self, each: impl Fn(usize) + Sync) -> Result<()> {
        if let Some(&index) = self.missing(Shard::WHOLE).first() {
            bail!("{}: is missing or not whole", self.file(index).display());
        }
        let hashes = self.hashes.as_ref().with_context(|| {
            format!(
                "{}: is missing; the command that made the set writes it",
                self.path.join(HASHES).display()
            )
        })?;
        for file in episode_files(&self.path)? {
            let name = file.file_stem().unwrap_or_default();
            ensure!(
                self.set.episodes.iter().any(|episode| name == episode.name.as_str()),
                "{}: is not in {SET}",
                file.display()
            );
        }
        let all: Vec<usize> = (0..self.set.episodes.len()).collect();
        for (index, hash) in self.read_hashes(&all, each)? {
            if hash != hashes.episodes[index].hash {
                bail!("{}: differs from what {HASHES} says of it", self.file(index).display());
            }
        }
        self.compare_with_frozen()
    }

    /// Hashes of files, in order; the first file that is not what the set says is the error.
    fn read_hashes(&self, indices: &[usize], each: impl Fn(usize) + Sync) -> Result<Vec<(usize, String)>> {
        let hash = |&index: &usize| -> Result<(usize, String)> {
            let (file, planned) = (self.file(index), &self.set.episodes[index]);
            let episode = Episode::read(&file)?;
            if recipe_of(&episode).as_ref() != Some(&planned.recipe) {
                bail!("{}: was not made by the recipe that {SET} has for it", file.display());
            }
            each(planned.frames);
            Ok((index, content_hash(&episode)))
        };
        let hashes: Vec<_> = indices.par_iter().map(hash).collect();
        hashes.into_iter().collect()
    }

    pub fn is_frozen(&self) -> bool {
        self.is_complete && self.frozen.is_some()
    }

    fn compare_with_frozen(&self) -> Result<()> {
        let frozen = self.frozen.iter().flat_map(|frozen| &frozen.episodes);
        let made = self.hashes.iter().flat_map(|hashes| &hashes.episodes);
        if let Some(index) = frozen.zip(made).position(|(frozen, made)| frozen.hash != made.hash) {
            let file = self.file(index);
            bail!("{}: differs from the frozen test set of {}", file.display(), self.set.split);
        }
        Ok(())
    }

    /// One number that stands for the content of a complete set.
    pub fn hash(&self) -> Option<&str> {
        self.hashes.as_ref().filter(|_| self.is_complete).map(|hashes| hashes.set.as_str())
    }
}

/// What a file says; none where it is not there.
fn read<T, E>(file: &Path, parse: impl FnOnce(&str) -> Result<T, E>) -> Result<Option<T>>
where
    E: std::error::Error + Send + Sync + 'static,
{
    match fs::read_to_string(file) {
        Ok(text) => parse(&text).map(Some).with_context(|| file.display().to_string()),
        Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
            Ok(None)
        }
        Err(error) => Err(error).with_context(|| format!("{}: cannot read", file.display())),
    }
}

/// The `.npz` files of a folder by name; none where there is no folder.
fn episode_files(folder: &Path) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let paths = fs::read_dir(folder).and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
    let mut files: Vec<PathBuf> =
        paths.with_context(|| format!("{}: cannot read this folder", folder.display()))?;
    files.retain(|file| file.extension().is_some_and(|extension| extension == "npz"));
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense_synth::Split;

    #[test]
    fn a_frozen_set_of_other_content_is_refused_by_file() {
        let set = EpisodeSet::first(Split::Val, 0, 2);
        let hashes = |digits: [&str; 2]| digits.map(|digit| digit.repeat(64)).to_vec();
        let dir = |made: [&str; 2]| SetDir {
            path: "out".into(),
            made: Vec::new(),
            is_complete: true,
            hashes: Some(SetHashes::new(&set, hashes(made))),
            frozen: Some(FrozenSet::new(set.clone(), hashes(["a", "b"]), 2)),
            set: set.clone(),
        };
        dir(["a", "b"]).compare_with_frozen().unwrap();
        let error = dir(["a", "c"]).compare_with_frozen().unwrap_err().to_string();
        assert_eq!(error, "out/val-00001.npz: differs from the frozen test set of val");
    }
}
