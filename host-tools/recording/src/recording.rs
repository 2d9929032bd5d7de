//! What a recording of a bus holds, and which format a file has by its name.

use std::path::Path;

use crate::candump::LogEntry;

/// A format that carries CAN frames with their times.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// can-utils' text, `.log` or `.candump`.
    Candump,
    Mcap,
}

impl Format {
    /// By the ending of a file's name.
    pub fn from_path(path: &Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "log" | "candump" => Some(Self::Candump),
            "mcap" => Some(Self::Mcap),
            _ => None,
        }
    }
}

/// One entry of a recording.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    Frame(LogEntry),
    /// Position of a test stand's crosshead.
    Displacement {
        timestamp_us: u64,
        mm: f64,
    },
}

/// A recording in memory: for short ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recording {
    /// Frames, in the order of the file.
    pub entries: Vec<LogEntry>,
    /// Position of a test stand's crosshead: microseconds, mm.
    pub displacement: Vec<(u64, f64)>,
    /// What the file has and this cannot hold, or what is wrong with it, in words.
    pub notes: Vec<String>,
}
