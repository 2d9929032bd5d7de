//! What record and monitor share: frames from a source, on a thread of their own, until the end or Ctrl-C.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread;
use std::time::Duration;

use anyhow::{Context, Result};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::link::{Input, Place, open};

/// Frames between the source and who takes them: two seconds of a full bus. When there is no room the source waits,
/// and what a kernel then loses shows in the sequence numbers.
const QUEUE: usize = 16_384;
/// How long a quiet source keeps the others from their work.
const POLL: Duration = Duration::from_millis(50);

/// Ctrl-C was pressed, or the process was asked to end.
static STOP: AtomicBool = AtomicBool::new(false);

/// What came.
pub(super) enum Event {
    /// A frame.
    Frame(LogEntry),
    /// Nothing for a moment.
    Quiet,
    /// No more: the source has ended, or somebody asked to stop.
    End,
}

/// A source that is being read.
pub(super) struct Live(Receiver<Result<LogEntry>>);

impl Live {
    /// Open a source and begin to read it.
    pub fn start(place: &Place, data_mbit: u8) -> Result<Self> {
        let mut source = open(place, data_mbit)?;
        // A second command in one process has the handler of the first.
        let _ = ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed));
        let (send, receive) = sync_channel(QUEUE);
        thread::Builder::new()
            .name("source".to_owned())
            .spawn(move || {
                loop {
                    let sent = match source.receive() {
                        Ok(Input::Frame(entry)) => send.send(Ok(entry)),
                        Ok(Input::Other | Input::Idle) => Ok(()),
                        Ok(Input::End) => return,
                        Err(error) => {
                            // Nobody there to hear it: then it does not matter.
                            let _ = send.send(Err(error));
                            return;
                        }
                    };
                    if sent.is_err() {
                        return;
                    }
                }
            })
            .context("cannot start a thread")?;
        Ok(Self(receive))
    }

    /// The next thing that happens.
    pub fn next(&self) -> Result<Event> {
        if STOP.load(Ordering::Relaxed) {
            return Ok(Event::End);
        }
        match self.0.recv_timeout(POLL) {
            Ok(entry) => entry.map(Event::Frame),
            Err(RecvTimeoutError::Timeout) => Ok(Event::Quiet),
            Err(RecvTimeoutError::Disconnected) => Ok(Event::End),
        }
    }
}
