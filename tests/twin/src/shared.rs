//! What the models share with one another and with the bus.

use std::sync::{Mutex, MutexGuard};

/// Lock it. A panic ends the run, so none has left it locked.
pub fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().expect("no holder panics")
}
