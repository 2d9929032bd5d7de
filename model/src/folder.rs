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

#[cfg(test)]
mod tests {
    use slipsense::sensor::PiezoFrame;
    use slipsense_recording::Episode;

    use super::*;

    #[test]
    fn of_too_many_files_those_read_are_of_all_objects() {
        let folder = tempfile::tempdir().unwrap();
        let objects = ["mug", "rod", "tape"];
        for index in 0..12 {
            let mut meta = Meta::nominal(0.000_488);
            meta.other.insert("object".to_owned(), objects[index / 4].into());
            let episode = Episode {
                sensors: 1,
                piezo: vec![PiezoFrame::zeroed()],
                xl: vec![vec![[0; 3]; 34]],
                xl_end: vec![33],
                label: Some(vec![0]),
                meta,
                ..Episode::default()
            };
            episode.write(folder.path().join(format!("{index:02}.npz"))).unwrap();
        }
        let uses = ObjectUses { validation: objects.map(str::to_owned).into(), test: Vec::new() };
        let data = LabelledFolder { path: folder.path().to_owned(), uses };
        let read = |most| {
            let chosen = data.choose(Use::Validation, most).unwrap();
            let name = |path: &PathBuf| path.file_stem().unwrap().to_str().unwrap().to_owned();
            let files: Vec<String> = chosen.files.iter().map(name).collect();
            (files.join(" "), Vec::from_iter(chosen.objects).join(" "), chosen.left_out)
        };
        let of = |files: &str, objects: &str, left_out: Option<usize>| {
            let path = folder.path().display();
            let said = left_out.map(|count| format!("{path}: {count} of 12 validation episodes"));
            (files.to_owned(), objects.to_owned(), said)
        };
        assert_eq!(read(2), of("00 06", "mug rod", Some(2)));
        assert_eq!(read(3), of("00 04 08", "mug rod tape", Some(3)));
        assert_eq!(read(5), of("00 02 04 07 09", "mug rod tape", Some(5)));
        let all = of("00 01 02 03 04 05 06 07 08 09 10 11", "mug rod tape", None);
        assert_eq!([read(12), read(99)], [all.clone(), all]);
    }
}
