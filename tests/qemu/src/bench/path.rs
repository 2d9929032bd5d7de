//! Every frame from samples to CAN frames: as the inference task calls it, and once more by part, through a
//! network that is watched.

use core::hint::black_box;

use slipsense::board::SensedPart;
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp, frame_bytes};
use slipsense::contact::ContactSummary;
use slipsense::features::{LogMel, XlFrontEnd};
use slipsense::net::{Model, Network, Observer, SensorFeatures};
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Output, Pipeline};
use slipsense::sensor::SensorInput;
use slipsense::simd::Map;
use slipsense::wire::{RawForm, RawTransfer, Transmitter};
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::input::Header;
use slipsense_qemu::measured::{FrameCost, GO_FILE, Line, PARTS, Part, READY_FILE};

use crate::counter::{Counter, Mark};
use crate::measure::Bench;

/// Measure all frames of the file; `by_part`: also once more through a network that is watched.
pub fn measure(bench: &mut Bench, file: &mut File, header: &Header, model: Model<'static>, by_part: bool) {
    let sensors = header.sensors as usize;
    let mut pipeline = Pipeline::new(model, sensors).expect("the header was checked");
    bench.put(Line::Size { bytes: size_of_val(&pipeline) as u32, name: "Pipeline" });
    bench.put(Line::Size { bytes: size_of::<Model<'_>>() as u32, name: "Model" });
    let mut watched = by_part.then(|| Watched {
        network: Network::new(model),
        front_ends: [const { XlFrontEnd::new() }; MAX_SENSORS],
    });
    let mut wire = Wire { transmitter: Transmitter::new(header.node), raw: RawTransfer::new() };
    let mut record = [0; FRAME_BYTES_MAX];
    let record = &mut record[..frame_bytes(sensors)];
    let mut parts = [const { SensedPart::new() }; MAX_SENSORS];
    let parts = &mut parts[..sensors];
    for number in 0..header.frames {
        file.read_exact(record).expect("the file holds as many frames as it says");
        let stamp = decode_stamp(record).expect("a frame starts with its stamp");
        decode_parts(record, parts).expect("the file holds possible frames");
        if watched.is_none() && number + 1 == header.frames {
            wait_for_trace();
        }
        let cost = frame(&bench.counter, &mut pipeline, &mut wire, watched.as_mut(), stamp, parts);
        bench.put(Line::Frame(cost));
    }
}

/// Until the emulator writes down what is done.
fn wait_for_trace() {
    File::create(READY_FILE);
    while File::open(GO_FILE).is_none() {}
}

fn frame(
    counter: &Counter,
    pipeline: &mut Pipeline<'_>,
    wire: &mut Wire,
    watched: Option<&mut Watched>,
    stamp: FrameStamp,
    parts: &[SensedPart],
) -> FrameCost {
    let mut inputs = [SensorInput::default(); MAX_SENSORS];
    for (input, part) in inputs.iter_mut().zip(parts) {
        *input = part.input();
    }
    let inputs = &inputs[..parts.len()];
    let mut output = None;
    let step = counter.of(&mut || output = Some(pipeline.step(black_box(inputs))));
    let output = output.expect("the step was called");
    let wire = counter.of(&mut || wire.send(stamp, parts, &output));
    let parts = watched.map_or([0; PARTS], |watched| watched.step(counter, inputs));
    let mut cost = FrameCost { step, wire, parts };
    cost.parts[Part::Wire as usize] = wire;
    cost
}

/// What the inference task does with a result, a bus apart.
struct Wire {
    transmitter: Transmitter,
    raw: RawTransfer,
}

impl Wire {
    fn send(&mut self, stamp: FrameStamp, parts: &[SensedPart], output: &Output) {
        black_box(self.transmitter.slip(&output.slip_message(stamp, 0)));
        for (sensor, part) in parts.iter().enumerate() {
            let raw = output.raw_frame(stamp, sensor, part.input(), part.xl_end);
            self.transmitter.raw_later(RawForm::Plain, &raw, &mut self.raw);
            while let Some(can_frame) = self.raw.next_frame() {
                // By reference: a copy for the measurement is not part of it.
                black_box(&can_frame);
            }
        }
    }
}

/// The parts of the pipeline, called one by one.
struct Watched {
    network: Network<'static>,
    front_ends: [XlFrontEnd; MAX_SENSORS],
}

impl Watched {
    fn step(&mut self, counter: &Counter, inputs: &[SensorInput<'_>]) -> [u32; PARTS] {
        let mut costs = [0; PARTS];
        let mut log_mel = [LogMel::default(); MAX_SENSORS];
        for ((input, front_end), log_mel) in inputs.iter().zip(&mut self.front_ends).zip(&mut log_mel) {
            if let Some(frame) = input.piezo {
                costs[Part::Contact as usize] +=
                    counter.of(&mut || _ = black_box(ContactSummary::new(black_box(frame))));
            }
            if let Some(samples) = input.xl {
                costs[Part::FrontEnd as usize] += counter.of(&mut || {
                    front_end.push(black_box(samples));
                    *log_mel = front_end.log_mel();
                });
            }
        }
        let mut features = [SensorFeatures::default(); MAX_SENSORS];
        for ((to, input), log_mel) in features.iter_mut().zip(inputs).zip(&log_mel) {
            *to = SensorFeatures { piezo: input.piezo, log_mel: input.xl.map(|_| &log_mel.standardised) };
        }
        let mut watch = Watch { counter, last: counter.mark(), costs };
        black_box(self.network.step_observed(black_box(&features[..inputs.len()]), &mut watch));
        watch.costs
    }
}

/// Reads the counter whenever the network shows an activation, and books what passed since the last one to the
/// part that gave it. A norm is shown by whatever comes after it: the first cross-attention's belongs to the
/// second anyway.
struct Watch<'c> {
    counter: &'c Counter,
    last: Mark,
    costs: [u32; PARTS],
}

impl Watch<'_> {
    #[inline(always)]
    fn book(&mut self, part: Option<Part>) {
        let passed = self.counter.since(self.last);
        if let Some(part) = part {
            self.costs[part as usize] += passed;
        }
        self.last = self.counter.mark();
    }
}

impl Observer for Watch<'_> {
    // An untouched pad is skipped here as it is where nobody looks.
    const ENABLED: bool = false;

    fn record(&mut self, layer: &'static str, values: &[i16]) {
        black_box(values);
        self.book(match layer {
            // What lies before the log-mel frame is the pad, shown or not: an untouched one is not.
            "taxels" | "log_mel" => Some(Part::Piezo),
            "piezo.conv1" => Some(Part::Conv1),
            "piezo.conv2" => Some(Part::Conv2),
            "piezo.conv3" => Some(Part::Conv3),
            "piezo" => Some(Part::PiezoDense),
            "xl.conv" | "xl.mix1" | "xl" => Some(Part::XlEncoder),
            "fused" => Some(Part::CrossAttention),
            "hidden" => Some(Part::TemporalAttention),
            "logits" => Some(Part::Head),
            _ => None,
        });
    }

    fn record_map(&mut self, layer: &'static str, _channels: usize, map: Map<'_>) {
        black_box(map.words);
        self.record(layer, &[]);
    }

    fn record_residual(&mut self, block: &'static str, values: &[i32]) {
        black_box(values);
        self.book(Some(attention(block)));
    }

    fn record_part(&mut self, block: &'static str, _part: &'static str, values: &[i16]) {
        black_box(values);
        self.book(Some(attention(block)));
    }
}

fn attention(block: &str) -> Part {
    if block == "temporal" { Part::TemporalAttention } else { Part::CrossAttention }
}
