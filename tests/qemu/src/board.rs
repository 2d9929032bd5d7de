//! The emulated board: frames come from a file, results go to one.

use core::cell::RefCell;

use critical_section::{Mutex, with};
use embassy_time::{Instant, Timer};
use heapless::Vec;
use slipsense::board::replay::{CAN_FRAMES_MAX, FRAME_BYTES_MAX, decode_parts, decode_stamp, frame_bytes};
use slipsense::board::{FrameSource, Observe};
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output};
use slipsense::sensor::SensorReadings;
use slipsense::wire::CanFrame;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;
use slipsense_qemu::record::Record;

/// Pause between two ticks. Short, so that the input is not what takes the time, and a real wait on the
/// timer, so that acquisition interrupts inference as on a board.
const TICK_US: u64 = 200;

pub struct Recording {
    pub file: File,
    pub header: Header,
    pub read: u32,
    pub record: [u8; FRAME_BYTES_MAX],
}

impl FrameSource for Recording {
    const REAL_TIME: bool = false;

    async fn tick(&mut self) -> Option<FrameStamp> {
        if self.read == self.header.frames {
            return None;
        }
        Timer::after_micros(TICK_US).await;
        self.read += 1;
        let record = self.record.get_mut(..frame_bytes(self.header.sensors as usize));
        let record = record.expect("the header was checked");
        self.file.read_exact(record).expect("the input file ends inside a frame");
        decode_stamp(record)
    }

    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        let parts = parts.get_mut(..self.header.sensors as usize).expect("the header was checked");
        decode_parts(&self.record, parts).expect("the input file holds an impossible frame");
    }
}

/// Gathers everything that one frame leads to and writes it to the output file.
pub struct Recorder {
    pub file: File,
    pub began: Instant,
    pub record: Record,
    pub encoded: Vec<u8, { 512 + CAN_FRAMES_MAX * 69 }>,
}

/// The recorder: it takes what is sent, and observes the inference task.
#[derive(Clone, Copy)]
pub struct Recorded(pub &'static Mutex<RefCell<Recorder>>);

impl Recorded {
    fn change<T>(&self, change: impl FnOnce(&mut Recorder) -> T) -> T {
        with(|cs| change(&mut self.0.borrow_ref_mut(cs)))
    }

    pub fn send(&self, frame: &CanFrame) {
        self.change(|recorder| recorder.record.can.push(*frame)).expect("room for all CAN frames of a frame");
    }
}

impl Observe for Recorded {
    fn step_begins(&mut self, _stamp: FrameStamp) {
        self.change(|recorder| recorder.began = Instant::now());
    }

    fn step_ends(&mut self, stamp: FrameStamp, output: &Output) {
        self.change(|recorder| {
            let step_us = recorder.began.elapsed().as_micros() as u32;
            recorder.record = Record { step_us, ..Record::new(stamp.sequence, output) };
        });
    }

    /// Transmission interrupts inference as soon as there is something to send, so all of it has gone by now.
    fn frame_done(&mut self, _stamp: FrameStamp) {
        self.change(|Recorder { file, record, encoded, .. }| {
            encoded.clear();
            record.encode(|bytes| encoded.extend_from_slice(bytes).expect("room for a record"));
            file.write_all(encoded);
        });
    }
}
