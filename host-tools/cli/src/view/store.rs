//! Frames between whoever makes them and whoever looks: the last so many, in order.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;

use super::record::{self, Record};

/// What does not change while a source runs.
#[derive(Clone, Debug, Serialize)]
pub struct Session {
    /// Another one after a restart, so that a page knows to begin anew.
    pub id: u64,
    /// File or bus.
    pub name: String,
    /// Are the sensors' data made by a generator? `None`: nobody says.
    pub synthetic: Option<bool>,
    /// Sensors of every record.
    pub sensors: usize,
    /// Bytes of a record.
    pub record_bytes: usize,
    /// Frames per second.
    pub frame_rate_hz: u32,
    /// Does it go on by itself? Then the page shows the newest frame.
    pub live: bool,
}

/// Where a session stands.
#[derive(Clone, Debug, Serialize)]
pub struct State {
    /// What it is.
    #[serde(flatten)]
    pub session: Session,
    /// Number of the oldest frame that is still there, counted from the first that came.
    pub first: u64,
    /// Number of the frame that comes next.
    pub end: u64,
    /// Will there be no more?
    pub ended: bool,
    /// Frames lost so far, by their sequence numbers.
    pub lost: u64,
    /// Why the source ended before its end, if it did.
    pub problem: Option<String>,
}

struct Kept {
    records: VecDeque<Vec<u8>>,
    /// As many as records.
    marks: VecDeque<u8>,
    state: State,
}

/// The last frames of a session.
pub struct Store {
    kept: Mutex<Kept>,
    changed: Condvar,
    capacity: usize,
}

impl Store {
    /// Room for `capacity` frames; after that the oldest goes when a new one comes.
    pub fn new(session: Session, capacity: usize) -> Self {
        let state = State { session, first: 0, end: 0, ended: false, lost: 0, problem: None };
        let kept = Kept { records: VecDeque::new(), marks: VecDeque::new(), state };
        Self { kept: Mutex::new(kept), changed: Condvar::new(), capacity: capacity.max(1) }
    }

    fn lock(&self) -> MutexGuard<'_, Kept> {
        // Every change is whole before the lock is let go.
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next frame.
    pub fn push(&self, record: &Record) {
        let mut kept = self.lock();
        let encoded = record.encode(kept.state.session.sensors);
        debug_assert_eq!(encoded.len(), record::bytes(kept.state.session.sensors));
        kept.records.push_back(encoded);
        kept.marks.push_back(record.mark());
        kept.state.end += 1;
        kept.state.lost += u64::from(record.lost);
        if kept.records.len() > self.capacity {
            kept.records.pop_front();
            kept.marks.pop_front();
            kept.state.first += 1;
        }
        drop(kept);
        self.changed.notify_all();
    }

    /// There will be no more; `problem`: why, if that is not as it should be.
    pub fn end(&self, problem: Option<String>) {
        let mut kept = self.lock();
        kept.state.ended = true;
        kept.state.problem = problem;
        drop(kept);
        self.changed.notify_all();
    }

    /// Where it stands.
    pub fn state(&self) -> State {
        self.lock().state.clone()
    }

    /// At most `count` frames from number `from` on, or from the oldest that is there: the number of the first, and
    /// their bytes. Waits up to `patience` for the first.
    pub fn records(&self, from: u64, count: usize, patience: Duration) -> (u64, Vec<u8>) {
        let (range, kept) = self.wait(from, count, patience);
        let first = kept.state.first + range.start as u64;
        (first, kept.records.range(range).flatten().copied().collect())
    }

    /// The marks of all frames from number `from` on: the number of the first, and a byte each.
    pub fn marks(&self, from: u64, patience: Duration) -> (u64, Vec<u8>) {
        let (range, kept) = self.wait(from, usize::MAX, patience);
        (kept.state.first + range.start as u64, kept.marks.range(range).copied().collect())
    }

    fn wait(&self, from: u64, count: usize, patience: Duration) -> (Range<usize>, MutexGuard<'_, Kept>) {
        let nothing_yet = |kept: &mut Kept| kept.state.end <= from && !kept.state.ended;
        let waited = self.changed.wait_timeout_while(self.lock(), patience, nothing_yet);
        let (kept, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let start = from.saturating_sub(kept.state.first).min(kept.records.len() as u64) as usize;
        let end = start.saturating_add(count).min(kept.records.len());
        (start..end, kept)
    }
}
