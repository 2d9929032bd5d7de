//! The counter, and the file that its results go to.

use core::fmt::{self, Write};

use heapless::String;
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp, frame_bytes};
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorReadings;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;
use slipsense_qemu::measured::MEASURED_FILE;

use crate::counter::Counter;

pub struct Bench {
    pub counter: Counter,
    file: File,
}

impl Bench {
    /// With a check of the counter as the first line.
    pub fn start() -> Self {
        let mut bench = Self { counter: Counter::start(), file: File::create(MEASURED_FILE) };
        let (expected, measured) = bench.counter.check();
        bench.put(format_args!("check {expected} {measured}\n"));
        bench
    }

    pub fn kernel(&mut self, name: &str, macs: usize, work: &mut dyn FnMut()) {
        let instructions = self.counter.of(work);
        self.put(format_args!("kernel {macs} {instructions} {name}\n"));
    }

    pub fn put(&mut self, line: fmt::Arguments<'_>) {
        let mut text = String::<256>::new();
        text.write_fmt(line).expect("a line is short");
        self.file.write_all(text.as_bytes());
    }
}

pub fn each_frame(
    file: &mut File,
    header: &Header,
    mut measure: impl FnMut(u32, FrameStamp, &[SensorReadings]),
) {
    let sensors = header.sensors as usize;
    let mut record = [0; FRAME_BYTES_MAX];
    let record = &mut record[..frame_bytes(sensors)];
    let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
    let parts = &mut parts[..sensors];
    for number in 0..header.frames {
        file.read_exact(record).expect("the file holds as many frames as it says");
        let stamp = decode_stamp(record).expect("a frame starts with its stamp");
        decode_parts(record, parts).expect("the file holds possible frames");
        measure(number, stamp, parts);
    }
}
