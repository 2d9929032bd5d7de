//! What can be wrong with an episode, said in one line.

use std::fmt::Display;
use std::io;
use std::path::{Path, PathBuf};

/// A file that could not be read or written, and why.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct EpisodeError {
    pub path: PathBuf,
    pub problem: Problem,
}

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The operating system refused to open or read.
    #[error("cannot read: {0}")]
    Read(io::Error),
    /// The operating system refused to create, write or rename. Nothing is left behind.
    #[error("cannot write: {0}")]
    Write(#[from] io::Error),
    /// The rule that is broken, naming array and index where there is one.
    #[error("{0}")]
    Rule(String),
}

impl Problem {
    /// Name the file.
    pub(crate) fn at(self, path: &Path) -> EpisodeError {
        EpisodeError { path: path.to_owned(), problem: self }
    }

    pub(crate) fn missing(array: &str) -> Self {
        Self::Rule(format!("array `{array}` is missing"))
    }

    pub(crate) fn array(array: &str, rule: impl Display) -> Self {
        Self::Rule(format!("array `{array}`: {rule}"))
    }

    /// `index`: position, one number per axis.
    pub(crate) fn element(array: &str, index: &[usize], value: impl Display, rule: impl Display) -> Self {
        Self::Rule(format!("`{array}`{index:?} is {value}: {rule}"))
    }
}
