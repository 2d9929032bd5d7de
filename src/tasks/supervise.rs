//! Is every task alive? The watchdog is fed only if all of them have moved on.

use core::sync::atomic::{AtomicU32, Ordering};

use crate::board::Watchdog;

/// A task that has to move on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// [`acquire`](super::acquire): at every tick.
    Acquire = 0,
    /// [`Inference`](super::Inference): at every frame.
    Infer = 1,
    /// [`Transmission`](super::Transmission): at every slip message, also when the bus takes none.
    Transmit = 2,
    /// The services on the bus. Whoever writes that task has it report several times per watchdog period, also when
    /// nobody asks for anything.
    Services = 3,
}

impl Task {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Acquire, Self::Infer, Self::Transmit, Self::Services];
}

/// How far each task has come; wraps.
#[derive(Debug)]
pub struct Progress([AtomicU32; Task::ALL.len()]);

impl Progress {
    /// Nothing done.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; Task::ALL.len()])
    }

    /// This task has done something.
    pub fn made(&self, task: Task) {
        // Each counter has one writer, and `task` is always one of the array's.
        if let Some(count) = self.0.get(task as usize) {
            count.store(count.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
        }
    }

    fn counts(&self) -> [u32; Task::ALL.len()] {
        self.0.each_ref().map(|count| count.load(Ordering::Relaxed))
    }
}

/// Notes which tasks stand still, for the record of a restart by the watchdog. Looks from where a task that holds its
/// executor does not keep it from looking: from an interrupt.
#[derive(Clone, Debug)]
pub struct StallWatch {
    seen: [u32; Task::ALL.len()],
}

impl StallWatch {
    /// Before the first look.
    pub const fn new() -> Self {
        Self { seen: [0; Task::ALL.len()] }
    }

    /// Tasks that have not moved on since the last look: bit n for task n.
    pub fn look(&mut self, progress: &Progress) -> u8 {
        let counts = progress.counts();
        let still = counts.iter().zip(&self.seen).enumerate().filter(|(_, (count, seen))| count == seen);
        let mask = still.fold(0, |mask, (task, _)| mask | 1 << task);
        self.seen = counts;
        mask
    }
}

/// Feeds the watchdog when all tasks have made progress since the last feed.
#[derive(Clone, Debug)]
pub struct Supervisor<'a> {
    tasks: &'a [Task],
    fed_at: [u32; Task::ALL.len()],
}

impl<'a> Supervisor<'a> {
    /// Watch these tasks.
    pub const fn new(tasks: &'a [Task]) -> Self {
        Self { tasks, fed_at: [0; Task::ALL.len()] }
    }

    /// Feed, if everybody has moved on; else `Err` with the first that has not. Call it several times per watchdog
    /// period; it does not matter from where, because a caller that stands still feeds nothing.
    pub fn look(&mut self, progress: &Progress, watchdog: &mut impl Watchdog) -> Result<(), Task> {
        let counts = progress.counts();
        let stalled = |&&task: &&Task| counts.get(task as usize) == self.fed_at.get(task as usize);
        if let Some(&task) = self.tasks.iter().find(stalled) {
            return Err(task);
        }
        self.fed_at = counts;
        watchdog.feed();
        Ok(())
    }
}
