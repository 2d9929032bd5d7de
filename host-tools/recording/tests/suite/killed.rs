//! A recorder that is killed at any of its writes, or within one, leaves an MCAP file with everything that was flushed
//! before. `cargo xtask linux` kills a real one.

use std::cell::RefCell;
use std::io::{Cursor, Result, Seek, SeekFrom, Write};
use std::rc::Rc;

use slipsense::wire::CanFrame;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::log_file::Record;
use slipsense_recording::mcap_file::{McapSink, McapSource};

/// Frames between two flushes, and flushes.
const FRAMES: usize = 7;
const FLUSHES: usize = 4;

/// A file, how many frames are flushed, and what both were in the middle of each write and after it.
#[derive(Default)]
struct File {
    content: Cursor<Vec<u8>>,
    flushed: usize,
    states: Vec<(usize, Vec<u8>)>,
}

#[derive(Clone, Default)]
struct Disk(Rc<RefCell<File>>);

impl Write for Disk {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let mut file = self.0.borrow_mut();
        for part in [&bytes[..bytes.len() / 2], &bytes[bytes.len() / 2..]] {
            file.content.write_all(part)?;
            let state = (file.flushed, file.content.get_ref().clone());
            file.states.push(state);
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Seek for Disk {
    fn seek(&mut self, to: SeekFrom) -> Result<u64> {
        self.0.borrow_mut().content.seek(to)
    }
}

/// The entries of an MCAP file.
pub fn parse(bytes: &[u8]) -> anyhow::Result<Vec<Record>> {
    McapSource::new(bytes, bytes.len() as u64).collect()
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
        disk.0.borrow_mut().flushed += FRAMES;
    }
    sink.finish().unwrap();
    let mut states = disk.0.take().states;
    states.retain(|(flushed, _)| *flushed > 0);
    assert!(states.len() > FLUSHES * 4, "{} writes", states.len());
    for (flushed, bytes) in states {
        let found = parse(&bytes).unwrap_or_else(|error| panic!("{flushed} flushed: {error:#}"));
        assert!(found.len() >= flushed, "{} of {flushed} flushed", found.len());
        let frames: Vec<_> = sent[..found.len()].iter().cloned().map(Record::Frame).collect();
        assert_eq!(found, frames, "what there is, is what was sent");
    }
}
