//! What can be wrong with an episode, said in one line.

use std::io;
use std::path::{Path, PathBuf};

/// A file that could not be read or written, and why.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct EpisodeError {
    /// The file.
    pub path: PathBuf,
    /// The rule that it breaks.
    pub problem: Problem,
}

/// The rule that is broken, naming array and index where there is one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The operating system refused to open or read.
    #[error("cannot read: {0}")]
    Read(io::Error),
    /// The operating system refused to create, write or rename. Nothing is left behind.
    #[error("cannot write: {0}")]
    Write(#[from] io::Error),
    /// The path is a folder.
    #[error("is a folder, must be an .npz file")]
    Folder,
    /// Not a zip archive, or cut short, or damaged.
    #[error("{0}")]
    Archive(String),
    /// A required array is absent.
    #[error("array `{array}` is missing")]
    Missing {
        /// Name of the array.
        array: &'static str,
    },
    /// An array is damaged or of a kind not read here.
    #[error("array `{array}`: {rule}")]
    Array {
        /// Name of the array.
        array: &'static str,
        /// What is wrong and what would be right.
        rule: String,
    },
    /// One element is out of range.
    #[error("`{array}`{index:?} is {value}: {rule}")]
    Element {
        /// Name of the array.
        array: &'static str,
        /// Position, one number per axis.
        index: Vec<usize>,
        /// The value found.
        value: String,
        /// The rule.
        rule: String,
    },
    /// A key of `meta` is missing or out of range.
    #[error("`meta` key `{key}` {rule}")]
    Meta {
        /// The JSON key.
        key: String,
        /// The rule.
        rule: String,
    },
}

impl Problem {
    /// Name the file.
    pub(crate) fn at(self, path: &Path) -> EpisodeError {
        EpisodeError { path: path.to_owned(), problem: self }
    }

    pub(crate) fn array(array: &'static str, rule: impl Into<String>) -> Self {
        Self::Array { array, rule: rule.into() }
    }

    pub(crate) fn element(
        array: &'static str,
        index: &[usize],
        value: impl ToString,
        rule: impl Into<String>,
    ) -> Self {
        Self::Element { array, index: index.to_vec(), value: value.to_string(), rule: rule.into() }
    }
}
