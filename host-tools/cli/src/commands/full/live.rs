//! What record and monitor share: frames from a source, on a thread of their own, until the end or a signal.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use serde::Serialize;
use slipsense_recording::candump::{Foreign, LogEntry};
use slipsense_recording::link::{Input, Place, Source, now_us, open};

/// Frames between the source and who takes them: two seconds of a full bus. When there is no room the source waits,
/// and what a kernel then drops is counted by it.
const QUEUE: usize = 16_384;
/// How long a quiet source keeps the others from their work.
const POLL: Duration = Duration::from_millis(50);
/// How long a source may take after the end to deliver what had come before it: its buffers hold less.
const DRAIN: Duration = Duration::from_secs(1);

/// Ctrl-C was pressed, or the process was asked to end.
static STOP: AtomicBool = AtomicBool::new(false);

pub(super) enum Event {
    Frame(LogEntry),
    /// Nothing for a moment.
    Quiet,
    /// No more: the source has ended, or somebody asked to stop, and every frame that had come has been taken.
    End,
}

/// What a source delivered beside frames of fingertips.
#[derive(Clone, Debug, Default, Serialize)]
pub(super) struct PassedOver {
    pub classic_frames: u32,
    /// CAN FD with an identifier of 11 bits.
    pub standard_id_frames: u32,
    pub error_frames: u32,
    /// Lines of an slcan adapter that make no sense.
    pub unreadable_lines: u32,
    /// Frames that the kernel dropped because this program was too slow.
    pub kernel_drops: u32,
    /// What a recording says at its end, such as that it was cut short.
    #[serde(skip)]
    pub notes: Vec<String>,
}

type Counters = Mutex<PassedOver>;

fn locked(counters: &Counters) -> MutexGuard<'_, PassedOver> {
    // Every change is complete before the lock is released.
    counters.lock().unwrap_or_else(PoisonError::into_inner)
}

/// `--data-mbit`.
#[derive(clap::Args)]
pub(super) struct DataRate {
    /// Bit rate of the data phase to set at an slcan adapter, Mbit/s
    #[arg(long, value_name = "MBIT", default_value = "8", value_parser = clap::value_parser!(u8).range(1..=8))]
    pub data_mbit: u8,
}

/// A source that is being read.
pub(super) struct Live {
    frames: Receiver<Result<LogEntry>>,
    counters: Arc<Counters>,
    stop: &'static AtomicBool,
}

impl Live {
    /// Open a source and begin to read it.
    pub fn start(place: &Place, data_mbit: u8) -> Result<Self> {
        let source = open(place, data_mbit)?;
        STOP.store(false, Ordering::Relaxed);
        // A second command in one process has the handler of the first.
        let _ = ctrlc::set_handler(|| {
            if STOP.swap(true, Ordering::Relaxed) {
                // Asked twice.
                std::process::exit(130);
            }
        });
        let (send, frames) = sync_channel(QUEUE);
        let counters = Arc::<Counters>::default();
        let counting = Arc::clone(&counters);
        thread::Builder::new()
            .name("source".to_owned())
            .spawn(move || read(source, &send, &counting, &STOP))
            .context("cannot start a thread")?;
        Ok(Self { frames, counters, stop: &STOP })
    }

    pub fn next(&self) -> Result<Event> {
        match self.frames.recv_timeout(POLL) {
            Ok(entry) => entry.map(Event::Frame),
            Err(RecvTimeoutError::Timeout) if !self.stop.load(Ordering::Relaxed) => Ok(Event::Quiet),
            Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => Ok(Event::End),
        }
    }

    /// What was passed over or lost so far.
    pub fn passed_over(&self) -> PassedOver {
        locked(&self.counters).clone()
    }

    /// Take no more than what has come by now.
    pub fn stop(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// Hand over frames until the source ends or nobody takes them; after a signal, those that had come before it.
fn read(mut source: Source, send: &SyncSender<Result<LogEntry>>, counters: &Counters, stop: &AtomicBool) {
    let mut stopped: Option<(Instant, u64)> = None;
    let dated = matches!(source, Source::SocketCan(_));
    while stopped.is_none_or(|(at, _)| at.elapsed() < DRAIN) {
        if stopped.is_none() && stop.load(Ordering::Relaxed) {
            stopped = Some((Instant::now(), now_us()));
        }
        let received = source.receive();
        locked(counters).kernel_drops = source.kernel_drops();
        let sent = match received {
            // The kernel's time: it came afterwards.
            Ok(Input::Frame(entry)) if dated && stopped.is_some_and(|(_, us)| entry.timestamp_us > us) => {
                return;
            }
            Ok(Input::Frame(entry)) => send.send(Ok(entry)),
            Ok(Input::Other(kind)) => {
                let mut counters = locked(counters);
                let count = match kind {
                    Foreign::Classic => &mut counters.classic_frames,
                    Foreign::Standard => &mut counters.standard_id_frames,
                    Foreign::Error => &mut counters.error_frames,
                    Foreign::Unreadable => &mut counters.unreadable_lines,
                };
                *count += 1;
                Ok(())
            }
            Ok(Input::Idle) if stopped.is_some() => return,
            Ok(Input::Idle) => Ok(()),
            Ok(Input::End) => {
                locked(counters).notes = source.notes();
                return;
            }
            Err(error) => {
                // Nobody there to take it: then it does not matter.
                let _ = send.send(Err(error));
                return;
            }
        };
        if sent.is_err() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::net::TcpListener;

    use slipsense::wire::{NodeId, SlipMessage, Transmitter};
    use slipsense_recording::slcan;

    use super::*;

    #[test]
    fn what_had_come_before_a_signal_is_taken() {
        static SIGNALLED: AtomicBool = AtomicBool::new(true);
        let (send, frames) = sync_channel(QUEUE);
        let live = Live { frames, counters: Arc::default(), stop: &SIGNALLED };
        let frame = Transmitter::new(NodeId::DEFAULT).slip(&SlipMessage::default());
        for timestamp_us in 0..1_000 {
            send.send(Ok(LogEntry { timestamp_us, interface: "can0".to_owned(), frame })).unwrap();
        }
        // The source still blocks in a read, as a pipe's does.
        let taken = std::iter::from_fn(|| matches!(live.next(), Ok(Event::Frame(_))).then_some(())).count();
        assert_eq!(taken, 1_000);
        assert!(matches!(live.next(), Ok(Event::End)));
    }
    /// And so is what waits in the kernel, in several reads; what makes no sense is counted.
    #[test]
    fn a_source_is_drained_after_a_signal() {
        let frame = Transmitter::new(NodeId::DEFAULT).slip(&SlipMessage::default());
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let source = open(&Place::Tcp(listener.local_addr().unwrap().to_string()), 8).unwrap();
        let mut adapter = listener.accept().unwrap().0;
        let lines = slcan::command(&frame).repeat(200) + "B0478\rt1230\r\x07z\r" + &slcan::command(&frame);
        adapter.write_all(lines.as_bytes()).unwrap();
        let ((send, frames), counters) = (sync_channel(QUEUE), Arc::<Counters>::default());
        read(source, &send, &counters, &AtomicBool::new(true));
        drop(send);
        let live = Live { frames, counters, stop: &STOP };
        assert_eq!(live.frames.iter().filter(Result::is_ok).count(), 201);
        let PassedOver { unreadable_lines, classic_frames, .. } = live.passed_over();
        assert_eq!((unreadable_lines, classic_frames), (1, 1));
    }
}
