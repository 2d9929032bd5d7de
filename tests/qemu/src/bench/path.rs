//! Every frame from samples to CAN frames, as the inference task calls it.

use core::hint::black_box;

use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output, Pipeline};
use slipsense::sensor::{SensorInput, SensorReadings};
use slipsense::wire::{Origin, RawForm, RawTransfer, Transmitter};
use slipsense_qemu::emulated::each_frame;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;
use slipsense_qemu::measured::{GO_FILE, READY_FILE};

use crate::measure::Bench;

/// Measure all frames of the file; `traced`: wait before the last one until the emulator writes down what is done.
pub fn measure(bench: &mut Bench, file: &mut File, header: &Header, model: Model<'static>, traced: bool) {
    let mut pipeline = Pipeline::new(model, header.sensors as usize).expect("the header was checked");
    let mut wire = Wire { transmitter: Transmitter::new(header.node), raw: RawTransfer::new() };
    each_frame(file, header, |number, stamp, parts| {
        if traced && number + 1 == header.frames {
            wait_for_trace();
        }
        frame(bench, &mut pipeline, &mut wire, stamp, parts);
    });
}

/// Until the emulator writes down what is done.
fn wait_for_trace() {
    File::create(READY_FILE);
    while File::open(GO_FILE).is_none() {}
}

fn frame(
    bench: &mut Bench,
    pipeline: &mut Pipeline<'_>,
    wire: &mut Wire,
    stamp: FrameStamp,
    parts: &[SensorReadings],
) {
    let mut inputs = [SensorInput::default(); MAX_SENSORS];
    for (input, part) in inputs.iter_mut().zip(parts) {
        *input = part.input();
    }
    let inputs = &inputs[..parts.len()];
    let mut output = None;
    let step = bench.counter.of(&mut || output = Some(pipeline.step(black_box(inputs))));
    let output = output.expect("the step was called");
    let wire = bench.counter.of(&mut || wire.send(stamp, parts, &output));
    bench.put(format_args!("frame {step} {wire}\n"));
}

/// What the inference task does with a result, a bus apart.
struct Wire {
    transmitter: Transmitter,
    raw: RawTransfer,
}

impl Wire {
    fn send(&mut self, stamp: FrameStamp, parts: &[SensorReadings], output: &Output) {
        black_box(self.transmitter.slip(&output.slip_message(stamp, &Origin::default())));
        for (sensor, part) in parts.iter().enumerate() {
            let raw = output.raw_frame(stamp, sensor, part.input());
            self.transmitter.start_raw(RawForm::Plain, &raw, &mut self.raw);
            while let Some(can_frame) = self.raw.next_frame() {
                // By reference: a copy for the measurement is not part of it.
                black_box(&can_frame);
            }
        }
    }
}
