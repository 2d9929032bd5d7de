//! The emulated board: frames come from a file, results go to one.

use core::cell::RefCell;
use core::convert::Infallible;

use embassy_time::{Instant, Timer};
use heapless::Vec;
use slipsense::board::{CanTransmit, FrameSource, Observe, SensedPart};
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output};
use slipsense::wire::CanFrame;
use slipsense_qemu::input::{FRAME_BYTES_MAX, Header, decode_parts, decode_stamp, frame_bytes};
use slipsense_qemu::record::{CAN_FRAMES_MAX, Record};

use crate::semihosting::File;

/// Pause between two ticks. Short, so that the input is not what takes the time, and a real wait on the
/// timer, so that acquisition interrupts inference as on a board.
const TICK_US: u64 = 200;

/// Frames from the input file.
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

    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]) {
        let parts = parts.get_mut(..self.header.sensors as usize).expect("the header was checked");
        decode_parts(&self.record, parts).expect("the input file holds an impossible frame");
    }

    async fn discard(&mut self) {}
}

/// Gathers everything that one frame leads to and writes it to the output file.
pub struct Recorder {
    pub file: File,
    pub began: Instant,
    pub record: Record,
    pub encoded: Vec<u8, { 512 + CAN_FRAMES_MAX * 69 }>,
}

/// The recorder as bus and as observer of the inference task.
#[derive(Clone, Copy)]
pub struct Shared(pub &'static RefCell<Recorder>);

impl CanTransmit for Shared {
    type Error = Infallible;

    async fn transmit(&mut self, frame: &CanFrame) -> Result<(), Infallible> {
        self.0.borrow_mut().record.can.push(*frame).expect("room for all CAN frames of a frame");
        Ok(())
    }
}

impl Observe for Shared {
    fn step_begins(&mut self, _stamp: FrameStamp) {
        self.0.borrow_mut().began = Instant::now();
    }

    fn step_ends(&mut self, stamp: FrameStamp, output: &Output) {
        let mut recorder = self.0.borrow_mut();
        recorder.record = Record::of(stamp.sequence, output);
        recorder.record.step_us = recorder.began.elapsed().as_micros() as u32;
    }

    fn frame_sent(&mut self, _stamp: FrameStamp) {
        let Recorder { file, record, encoded, .. } = &mut *self.0.borrow_mut();
        encoded.clear();
        record.encode(|bytes| encoded.extend_from_slice(bytes).expect("room for a record"));
        file.write_all(encoded).expect("the host takes the output");
    }
}
