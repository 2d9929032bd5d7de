//! Every frame of every sensor compressed: what it costs, and how long it becomes.

use core::hint::black_box;

use slipsense::wire::{Detail, RawBuffer, RawFrame};
use slipsense_qemu::emulated::each_frame;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;

use crate::measure::Bench;
pub fn measure(bench: &mut Bench, file: &mut File, header: &Header) {
    let mut buffer = RawBuffer::new();
    each_frame(file, header, |_, stamp, parts| {
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
    });
}
