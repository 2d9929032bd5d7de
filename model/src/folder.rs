//! A folder of labelled episodes, such as `slipsense label` writes: which object is for what.
//!
//! Everything is checked before anything is unpacked: an hour of recordings takes a while to read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use sha2::{Digest, Sha256};
use slipsense_recording::Meta;
use slipsense_recording::npz::Reader;
use slipsense_synth::objects::{self, Group};

use crate::output;

/// What an episode may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// Gradients and calibration.
    Train,
    /// The curve that a person watches during training, the quantizer's table, operating points.
    Validation,
    /// Nothing here.
    Test,
}

impl Use {
    fn name(self) -> &'static str {
        match self {
            Self::Train => "training",
            Self::Validation => "validation",
            Self::Test => "test",
        }
    }
}

/// Objects that a person names for validation and for test.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ObjectUses {
    pub validation: Vec<String>,
    pub test: Vec<String>,
}

impl ObjectUses {
    /// What an object is for: as a person names it, else as the catalogue says. Others, from someone's own recordings,
    /// are for training where a person names any; else they go by a hash of their name, one in four to test, one in
    /// eight to validation.
    pub fn use_of(&self, object: &str) -> Use {
        if self.validation.iter().any(|name| name == object) {
            return Use::Validation;
        }
        if self.test.iter().any(|name| name == object) {
            return Use::Test;
        }
        match objects::named(object).map(|known| known.group) {
            Some(Group::HeldOut) => Use::Test,
            Some(Group::Val) => Use::Validation,
            Some(Group::Train) => Use::Train,
            None if !self.validation.is_empty() || !self.test.is_empty() => Use::Train,
            None => match Sha256::digest(object.as_bytes())[0] {
                0..64 => Use::Test,
                64..96 => Use::Validation,
                _ => Use::Train,
            },
        }
    }
}

#[derive(Clone, Debug)]
pub struct LabelledFolder {
    pub path: PathBuf,
    pub uses: ObjectUses,
}

/// What an episode's file says before its frames are unpacked.
struct Entry {
    path: PathBuf,
    sensors: usize,
    object: String,
}

/// What is read of a folder for a use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chosen {
    /// By name; at least one.
    pub files: Vec<PathBuf>,
    /// Their objects.
    pub objects: BTreeSet<String>,
    /// Where the folder has more files for this use: how many are read of how many.
    pub left_out: Option<String>,
}

impl LabelledFolder {
    /// At most `most` of the folder's episodes for a use, evenly spaced by name: the first ones may all be of one object.
    pub fn choose(&self, what: Use, most: usize) -> Result<Chosen> {
        let (path, name) = (self.path.display(), what.name());
        let all = self.entries()?;
        let of: Vec<&Entry> = all.iter().filter(|entry| self.uses.use_of(&entry.object) == what).collect();
        if of.is_empty() {
            let fix = match what {
                Use::Train => "record other objects too, or name fewer with --validation and --test",
                Use::Validation => "name one with --validation OBJECT, which training will then not see",
                Use::Test => "name one with --test OBJECT",
            };
            bail!("{path}: no object is for {name} ({}); {fix}", self.words(&all));
        }
        let count = most.min(of.len());
        let chosen: Vec<&Entry> = (0..count).map(|index| of[index * of.len() / count]).collect();
        Ok(Chosen {
            files: chosen.iter().map(|entry| entry.path.clone()).collect(),
            objects: chosen.iter().map(|entry| entry.object.clone()).collect(),
            left_out: (count < of.len()).then(|| format!("{path}: {count} of {} {name} episodes", of.len())),
        })
    }

    /// Objects by use, in words. An error if none is for training or none for validation.
    pub fn describe(&self) -> Result<String> {
        self.choose(Use::Train, 1)?;
        self.choose(Use::Validation, 1)?;
        Ok(self.words(&self.entries()?))
    }

    fn words(&self, entries: &[Entry]) -> String {
        let mut episodes: BTreeMap<&str, usize> = BTreeMap::new();
        for entry in entries {
            *episodes.entry(&entry.object).or_default() += 1;
        }
        let uses = [(Use::Train, "train"), (Use::Validation, "validation"), (Use::Test, "test")];
        let words = uses.map(|(what, name)| {
            let objects = episodes.iter().filter(|(object, _)| self.uses.use_of(object) == what);
            let objects: Vec<String> = objects.map(|(object, count)| format!("{object} × {count}")).collect();
            let list = if objects.is_empty() { "none".to_owned() } else { objects.join(", ") };
            format!("{name}: {list}")
        });
        words.join("; ")
    }

    fn entries(&self) -> Result<Vec<Entry>> {
        let paths = output::files(&self.path, "npz")?;
        ensure!(!paths.is_empty(), "{}: no .npz file", self.path.display());
        let entry = |path: &PathBuf| read_entry(path).with_context(|| path.display().to_string());
        let entries: Vec<Entry> = paths.iter().map(entry).collect::<Result<_>>()?;
        for entry in &entries[1..] {
            let first = &entries[0];
            ensure!(
                entry.sensors == first.sensors,
                "{} has {} sensors, {} has {}: all episodes of a folder must have the same number",
                entry.path.display(),
                entry.sensors,
                first.path.display(),
                first.sensors
            );
        }
        for name in self.uses.validation.iter().chain(&self.uses.test) {
            ensure!(
                entries.iter().any(|entry| entry.object == *name),
                "{}: no episode of the object \"{name}\" ({})",
                self.path.display(),
                self.words(&entries)
            );
        }
        Ok(entries)
    }
}

fn read_entry(path: &Path) -> Result<Entry> {
    let mut npz = Reader::open(path)?;
    let meta = Meta::from_json(&npz.array::<u8>("meta")?.read()?)?;
    ensure!(npz.has("label"), "array `label` is missing, needed for training: see `slipsense label --help`");
    let Some(object) = meta.other.get("object").and_then(|object| object.as_str()) else {
        bail!("`meta` has no \"object\", needed to split by object: see `slipsense label --object`");
    };
    let sensors = npz.array::<u16>("piezo")?.shape().get(1).copied().unwrap_or_default();
    Ok(Entry { path: path.to_owned(), sensors, object: object.to_owned() })
}
