//! Every frame of every sensor compressed: what it costs, and how long it becomes.

use core::hint::black_box;

use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp, frame_bytes};
use slipsense::params::MAX_SENSORS;
use slipsense::sensor::SensorReadings;
use slipsense::wire::{Detail, RawBuffer, RawFrame};
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;

use crate::measure::Bench;

pub fn measure(bench: &mut Bench, file: &mut File, header: &Header) {
    let sensors = header.sensors as usize;
    let mut record = [0; FRAME_BYTES_MAX];
    let record = &mut record[..frame_bytes(sensors)];
    let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
    let parts = &mut parts[..sensors];
    let mut buffer = RawBuffer::new();
    for _ in 0..header.frames {
        file.read_exact(record).expect("the file holds as many frames as it says");
        let stamp = decode_stamp(record).expect("a frame starts with its stamp");
        decode_parts(record, parts).expect("the file holds possible frames");
        for (sensor, part) in parts.iter().enumerate() {
            let raw = RawFrame {
                timestamp_us: stamp.timestamp_us,
                sequence: stamp.sequence,
                sensor: sensor as u8,
                health: 0,
                input: part.input(),
            };
            let mut bytes = 0;
            let instructions = bench.counter.of(&mut || {
                bytes = black_box(&raw).compress(Detail::All, black_box(&mut buffer)).len();
            });
            bench.put(format_args!("compressed {bytes} {instructions}\n"));
        }
    }
}
