//! The last frames of a session, in order: a source fills it, pages read it.

use std::collections::VecDeque;
use std::ops::Range;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use serde::Serialize;

use super::record::{self, Record};

/// What does not change while a source runs.
#[derive(Clone, Debug, Serialize)]
pub struct Session {
    /// Different after a restart, so that a page knows to start over.
    pub id: u64,
    pub name: String,
    /// Are the data generated? `None`: unknown.
    pub synthetic: Option<bool>,
    pub sensors: usize,
    pub record_bytes: usize,
    pub frame_rate_hz: u32,
    /// Does it go on by itself? Then the page follows the newest frame.
    pub live: bool,
}

#[derive(Clone, Debug, Serialize)]
pub struct State {
    #[serde(flatten)]
    pub session: Session,
    /// Number of the oldest frame still stored, counted from the first received.
    pub first: u64,
    pub end: u64,
    pub ended: bool,
    /// Frames lost so far, by their sequence numbers.
    pub lost: u64,
    /// Why the source stopped early, if it did.
    pub problem: Option<String>,
}

struct Stored {
    records: VecDeque<Vec<u8>>,
    marks: VecDeque<u8>,
    state: State,
}

pub struct Store {
    stored: Mutex<Stored>,
    changed: Condvar,
    capacity: usize,
}

impl Store {
    /// Keeps the last `capacity` frames.
    pub fn new(session: Session, capacity: usize) -> Self {
        let state = State { session, first: 0, end: 0, ended: false, lost: 0, problem: None };
        let stored = Stored { records: VecDeque::new(), marks: VecDeque::new(), state };
        Self { stored: Mutex::new(stored), changed: Condvar::new(), capacity: capacity.max(1) }
    }

    fn lock(&self) -> MutexGuard<'_, Stored> {
        // Every change is complete before the lock is released.
        self.stored.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn push(&self, record: &Record) {
        let mut stored = self.lock();
        let encoded = record.encode(stored.state.session.sensors);
        debug_assert_eq!(encoded.len(), record::bytes(stored.state.session.sensors));
        stored.records.push_back(encoded);
        stored.marks.push_back(record.mark());
        stored.state.end += 1;
        stored.state.lost += u64::from(record.lost);
        if stored.records.len() > self.capacity {
            stored.records.pop_front();
            stored.marks.pop_front();
            stored.state.first += 1;
        }
        drop(stored);
        self.changed.notify_all();
    }

    /// There will be no more frames; `problem`: what went wrong.
    pub fn end(&self, problem: Option<String>) {
        let mut stored = self.lock();
        stored.state.ended = true;
        stored.state.problem = problem;
        drop(stored);
        self.changed.notify_all();
    }

    pub fn state(&self) -> State {
        self.lock().state.clone()
    }

    /// At most `count` frames from number `from` on, or from the oldest stored: the number of the first, and their
    /// bytes. Waits up to `timeout` for the first.
    pub fn records(&self, from: u64, count: usize, timeout: Duration) -> (u64, Vec<u8>) {
        let (range, stored) = self.wait(from, count, timeout);
        let first = stored.state.first + range.start as u64;
        (first, stored.records.range(range).flatten().copied().collect())
    }

    /// The marks of all frames from number `from` on: the number of the first, and a byte each.
    pub fn marks(&self, from: u64, timeout: Duration) -> (u64, Vec<u8>) {
        let (range, stored) = self.wait(from, usize::MAX, timeout);
        (stored.state.first + range.start as u64, stored.marks.range(range).copied().collect())
    }

    fn wait(&self, from: u64, count: usize, timeout: Duration) -> (Range<usize>, MutexGuard<'_, Stored>) {
        let nothing_yet = |stored: &mut Stored| stored.state.end <= from && !stored.state.ended;
        let waited = self.changed.wait_timeout_while(self.lock(), timeout, nothing_yet);
        let (stored, _) = waited.unwrap_or_else(PoisonError::into_inner);
        let start = from.saturating_sub(stored.state.first).min(stored.records.len() as u64) as usize;
        let end = start.saturating_add(count).min(stored.records.len());
        (start..end, stored)
    }
}
