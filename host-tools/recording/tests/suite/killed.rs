//! A recorder that is killed at any of its writes, or within one, leaves an MCAP file with everything that was flushed
//! before. `cargo xtask linux` kills a real one.

use std::cell::RefCell;
use std::io::{Cursor, Result, Seek, SeekFrom, Write};
use std::rc::Rc;

use slipsense::wire::CanFrame;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::mcap_file::{McapSink, parse};

/// Frames between two flushes, and flushes.
const FRAMES: usize = 7;
const FLUSHES: usize = 4;

/// What a file held, and how many frames were flushed by then.
struct State {
    flushed: usize,
    bytes: Vec<u8>,
}

/// A file, and its state in the middle of each write and after it.
#[derive(Clone, Default)]
struct Disk {
    file: Rc<RefCell<Cursor<Vec<u8>>>>,
    flushed: Rc<RefCell<usize>>,
    states: Rc<RefCell<Vec<State>>>,
}

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        for part in [&bytes[..bytes.len() / 2], &bytes[bytes.len() / 2..]] {
            self.file.borrow_mut().write_all(part)?;
            let (flushed, bytes) = (*self.flushed.borrow(), self.file.borrow().get_ref().clone());
            self.states.borrow_mut().push(State { flushed, bytes });
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.file.borrow_mut().seek(to)
    }
}

fn entry(number: usize) -> LogEntry {
    let frame = CanFrame::new(0x0478_382A, &[number as u8; 64]).expect("a frame");
    LogEntry { timestamp_us: 1000 * number as u64, interface: "can0".to_owned(), frame }
}

#[test]
fn at_every_write_and_within_it() {
    let disk = Disk::default();
    let mut sink = McapSink::new(disk.clone()).unwrap();
    let sent: Vec<LogEntry> = (0..FRAMES * FLUSHES).map(entry).collect();
    for frames in sent.chunks(FRAMES) {
        frames.iter().for_each(|entry| sink.write(entry).unwrap());
        sink.flush().unwrap();
        *disk.flushed.borrow_mut() += FRAMES;
    }
    sink.finish().unwrap();
    let states = disk.states.take();
    let after_a_flush: Vec<_> = states.iter().filter(|state| state.flushed > 0).collect();
    assert!(after_a_flush.len() > FLUSHES * 4, "{} writes", after_a_flush.len());
    for State { flushed, bytes } in after_a_flush {
        let recording = parse(bytes).unwrap_or_else(|error| panic!("{flushed} flushed: {error:#}"));
        let found = recording.entries.len();
        assert!(found >= *flushed, "{found} of {flushed} flushed");
        assert_eq!(recording.entries, sent[..found], "what there is, is what was sent");
    }
}
