//! What the programs on the emulated board (QEMU's mps2-an500) share: files of the host, counting instructions, the end.

pub mod counter;
pub mod semihosting;

use cortex_m_semihosting::debug;
use panic_semihosting as _;
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp, frame_bytes};
use slipsense::net::{Aligned, Model};
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorReadings;
use static_cell::ConstStaticCell;

use crate::INPUT_FILE;
use crate::input::{HEADER_BYTES, Header, MODEL_BYTES_MAX};
use semihosting::File;

static MODEL: ConstStaticCell<Aligned<[u8; MODEL_BYTES_MAX]>> =
    ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));

/// The input file up to its first frame. Once.
pub fn read_input() -> (File, Header, Model<'static>) {
    let mut file = File::open(INPUT_FILE).expect("the input file is there");
    let mut header = [0; HEADER_BYTES];
    file.read_exact(&mut header).expect("the input file has a header");
    let header = Header::decode(&header).expect("the input file is one for this program");
    let (model, _) = MODEL.take().0.split_at_mut(header.model_bytes as usize);
    file.read_exact(model).expect("the input file holds a model");
    (file, header, Model::parse(model).expect("the model is valid"))
}

/// The frames of the input file, each with its number from 0.
pub fn each_frame(
    file: &mut File,
    header: &Header,
    mut take: impl FnMut(u32, FrameStamp, &[SensorReadings]),
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
        take(number, stamp, parts);
    }
}

/// End the emulator, which closes the files.
pub fn exit(success: bool) -> ! {
    debug::exit(if success { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::wfi();
    }
}
