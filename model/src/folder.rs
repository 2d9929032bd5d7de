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

/// What an object may be used for. The catalogue says it for its objects; others, from someone's own
/// recordings, go by a hash of their name: one in four to test, one in eight to validation.
pub fn use_of(object: &str) -> Use {
    match objects::named(object).map(|known| known.group) {
        Some(Group::HeldOut) => Use::Test,
        Some(Group::Val) => Use::Validation,
        Some(Group::Train) => Use::Train,
        None => match Sha256::digest(object.as_bytes())[0] {
            0..64 => Use::Test,
            64..96 => Use::Validation,
            _ => Use::Train,
        },
    }
}

/// Where a person says it: objects for validation and for test. Empty: [`use_of`] says it.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct ObjectUses {
    pub validation: Vec<String>,
    pub test: Vec<String>,
}

impl ObjectUses {
    /// What an object is for. Where a person names any, the objects that are not named are for training;
    /// objects of the catalogue stay what they are.
    pub fn use_of(&self, object: &str) -> Use {
        let named = |list: &[String]| list.iter().any(|name| name == object);
        if named(&self.validation) {
            Use::Validation
        } else if named(&self.test) {
            Use::Test
        } else if self.is_empty() || objects::named(object).is_some() {
            use_of(object)
        } else {
            Use::Train
        }
    }

    pub fn is_empty(&self) -> bool {
        self.validation.is_empty() && self.test.is_empty()
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

impl LabelledFolder {
    /// The folder's episodes for a use, by name; at least one.
    pub fn files(&self, what: Use) -> Result<Vec<PathBuf>> {
        let entries = self.entries()?;
        let of = |entry: &&Entry| self.uses.use_of(&entry.object) == what;
        let files: Vec<PathBuf> = entries.iter().filter(of).map(|entry| entry.path.clone()).collect();
        if files.is_empty() {
            let (need, fix) = match what {
                Use::Train => {
                    ("training", "record other objects too, or name fewer with --validation and --test")
                }
                Use::Validation => {
                    ("validation", "name one with --validation OBJECT, which training will then not see")
                }
                Use::Test => ("test", "name one with --test OBJECT"),
            };
            bail!("{}: no object is for {need} ({}); {fix}", self.path.display(), self.words(&entries));
        }
        Ok(files)
    }

    /// Objects by use, in words. An error if none is for training or none for validation.
    pub fn describe(&self) -> Result<String> {
        self.files(Use::Train)?;
        self.files(Use::Validation)?;
        Ok(self.words(&self.entries()?))
    }

    pub fn objects(&self, what: Use) -> Result<Vec<String>> {
        let names = self.entries()?.into_iter().map(|entry| entry.object);
        let names: BTreeSet<String> = names.filter(|name| self.uses.use_of(name) == what).collect();
        Ok(names.into_iter().collect())
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
