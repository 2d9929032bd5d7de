//! The kernels to be measured and how each is called. A kernel that changes its signature is adapted here and
//! nowhere else.

use core::hint::black_box;

use slipsense::contact::ContactSummary;
use slipsense::features::XlFrontEnd;
use slipsense::features::fft::{Work, windowed_fft};
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::fixed::{STANDARD_FRAC_BITS, saturate_i16, standardise};
use slipsense::net::Model;
use slipsense::net::activations::Activations;
use slipsense::net::attention::{KeyValueCache, attend};
use slipsense::net::dense::dense;
use slipsense::net::model::{Attention, LagBias, Layer, Norm};
use slipsense::net::packing::{self, Inputs};
use slipsense::net::softmax::softmax_base2;
use slipsense::params::limits::{EMBED, WINDOW};
use slipsense::params::{PIEZO_CHANNELS, TAXELS, XL_WINDOW};
use slipsense::pipeline::{Pipeline, State};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::simd::{Map, MapMut, MapShape, conv_relu_pool, pair};
use slipsense::tasks::{CheckedMemory, GOLDEN_FRAMES, RAM_SLICE_BYTES, RamPart, SelfCheck, digest};
use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};
use static_cell::ConstStaticCell;

use crate::measure::Bench;

/// Accelerometer samples of a frame, rounded.
const BATCH: usize = 33;
/// Words of the largest map, 32×32×8 with its border, and of the largest weights, 512×128.
const MAP: usize = 34 * 34 * 4;
const WEIGHTS: usize = 512 * 128 / 2;
/// Words of the largest strip: four rows of 8×8×16.
const STRIP: usize = 4 * 10 * 8;
const EMBED_WORDS: usize = EMBED / 2;

static X: ConstStaticCell<[u32; MAP]> = ConstStaticCell::new([0; MAP]);
static OUT: ConstStaticCell<[u32; MAP]> = ConstStaticCell::new([0; MAP]);
static ROWS: ConstStaticCell<[u32; STRIP]> = ConstStaticCell::new([0; STRIP]);
static NUMBERS: ConstStaticCell<[u32; WEIGHTS]> = ConstStaticCell::new([0; WEIGHTS]);

/// What the kernels work on: any numbers do, no kernel's instructions depend on them.
struct Memory {
    x: &'static mut [u32; MAP],
    out: &'static mut [u32; MAP],
    strip: &'static mut [u32; STRIP],
    numbers: &'static [u32; WEIGHTS],
}

pub fn measure(bench: &mut Bench, model: &Model<'static>) {
    let (x, numbers) = (X.take(), NUMBERS.take());
    x.iter_mut().chain(numbers.iter_mut()).zip(words()).for_each(|(to, word)| *to = word);
    let mut memory = Memory { x, out: OUT.take(), strip: ROWS.take(), numbers };
    reference(bench, &mut memory);
    shipped(bench, &mut memory, model);
    features(bench);
    wire(bench);
    self_check(bench, model);
}

/// Flash of any length that costs nothing to read, a slice of RAM, and a state that is cleared for the first time.
struct NoMemory([u32; RAM_SLICE_BYTES as usize / 4]);

impl CheckedMemory for NoMemory {
    fn read(&mut self, _: u32, _: &mut [u8]) {}

    fn digest(&mut self, _: RamPart, _: u32, _: u32, before: u32) -> u32 {
        black_box(&self.0).iter().copied().fold(before, digest)
    }

    fn clear(&mut self, _: &mut State) {}
}

fn self_check(bench: &mut Bench, model: &Model<'static>) {
    let pipeline = Pipeline::new(*model, 1).expect("one sensor");
    let memory = NoMemory([0; RAM_SLICE_BYTES as usize / 4]);
    let mut check = SelfCheck::new(memory, [(u32::MAX, 0); 2], (u32::MAX, None), pipeline, None);
    // The state is cleared; then the golden inference.
    (0..GOLDEN_FRAMES).for_each(|_| _ = black_box(check.step()));
    bench.kernel(
        "self check: 16 KB of RAM, 256 bytes of flash, a frame of the golden inference",
        0,
        &mut || {
            black_box(black_box(&mut check).step());
        },
    );
    bench.kernel("self check: 16 KB of RAM, 256 bytes of flash", 0, &mut || {
        black_box(black_box(&mut check).step());
    });
}

/// The shapes that the literature and the others are measured at.
fn reference(bench: &mut Bench, memory: &mut Memory) {
    let numbers = memory.numbers;
    let patch = |channels: usize| Inputs::Patch { channels, pairs: channels.div_ceil(2) };
    conv(bench, memory, "conv 3x3 32x32x1->8, ReLU, pool", &of_noise(numbers, patch(1), 8), 32);
    conv(bench, memory, "conv 3x3 16x16x8->16, ReLU, pool", &of_noise(numbers, patch(8), 16), 16);
    conv(bench, memory, "conv 3x3 8x8x16->32, ReLU, pool", &of_noise(numbers, patch(16), 32), 8);
    let vector = |count| Inputs::Vector { count };
    layer(bench, memory, "dense 512->128", &of_noise(numbers, vector(512), 128));
    layer(bench, memory, "dense 128->128", &of_noise(numbers, vector(128), 128));
    let square = of_noise(numbers, vector(64), 64);
    let halves: &'static [i16] = bytemuck::must_cast_slice(numbers.as_slice());
    let block = Attention {
        name: "",
        query: square,
        key: square,
        value: square,
        out: square,
        heads: 4,
        score_multiplier: 1 << 16,
        bias: LagBias::new(&halves[..4 * WINDOW], WINDOW),
        norm: Norm {
            residual: 1 << 20,
            gamma: halves,
            beta: bytemuck::must_cast_slice(numbers),
            multiplier: 1 << 20,
            epsilon: 1,
        },
    };
    key_value::<EMBED_WORDS>(bench, "key and value 64-d", &block);
    attention::<EMBED_WORDS>(bench, "attention 64-d, 4 heads, 60 keys: query, output, norm", &block);

    let mut scores = [[0; WINDOW]; 4];
    scores.as_flattened_mut().iter_mut().zip(noise()).for_each(|(score, x)| *score = i32::from(x) >> 3);
    bench.kernel("softmax 4x60", 0, &mut || {
        black_box(&mut scores).iter_mut().for_each(|row| softmax_base2(row))
    });
    let mut sums = [0; EMBED];
    sums.iter_mut().zip(noise()).for_each(|(sum, x)| *sum = i32::from(x) << 3);
    let mut out = [0; EMBED];
    bench.kernel("standardise 64", 0, &mut || {
        standardise::<STANDARD_FRAC_BITS>(black_box(&mut sums), 1, black_box(&mut out));
    });
}

fn of_noise(numbers: &'static [u32], inputs: Inputs, outputs: usize) -> Layer<'static> {
    let scales: &'static [i32] = bytemuck::must_cast_slice(numbers);
    let scales = &scales[..packing::padded_outputs(outputs)];
    let weights = &numbers[..packing::len(inputs, outputs) / 2];
    Layer { weights, bias: scales, multiplier: scales, inputs, outputs }
}

/// Every layer of the network in use.
fn shipped(bench: &mut Bench, memory: &mut Memory, model: &Model<'static>) {
    let Model { conv: [conv1, conv2, conv3], piezo_dense, xl: [xl_conv, mix1, mix2], .. } = model;
    conv(bench, memory, "shipped: conv1", conv1, 32);
    conv(bench, memory, "shipped: conv2", conv2, 16);
    conv(bench, memory, "shipped: conv3", conv3, 8);
    layer(bench, memory, "shipped: dense of the pad", piezo_dense);
    layer(bench, memory, "shipped: xl.conv", xl_conv);
    layer(bench, memory, "shipped: xl.mix1", mix1);
    layer(bench, memory, "shipped: xl.mix2", mix2);
    key_value::<EMBED_WORDS>(bench, "shipped: key and value of a cross-attention", &model.cross_piezo);
    attention::<EMBED_WORDS>(bench, "shipped: a cross-attention", &model.cross_piezo);
    key_value::<EMBED>(bench, "shipped: key and value over time", &model.temporal);
    attention::<EMBED>(bench, "shipped: attention over time", &model.temporal);
    layer(bench, memory, "shipped: head", &model.head);
}

fn conv(bench: &mut Bench, memory: &mut Memory, name: &str, layer: &Layer<'_>, side: usize) {
    let Inputs::Patch { pairs, .. } = layer.inputs else { return };
    let from = MapShape { side, pairs, border: 1 };
    // As in the network: what comes out of the smallest goes to a dense layer.
    let border = usize::from(side > 8);
    let to = MapShape { side: side / 2, pairs: packing::pairs(layer.outputs), border };
    let Memory { x, out, strip, .. } = memory;
    let (x, out, strip) = (&x[..from.len()], &mut out[..to.len()], &mut strip[..from.strip()]);
    bench.kernel(name, side * side * layer.inputs.count() * layer.outputs, &mut || {
        let out = MapMut { words: black_box(&mut *out), shape: to };
        conv_relu_pool(black_box(layer.params()), Map { words: black_box(x), shape: from }, out, strip);
    });
}

fn layer(bench: &mut Bench, memory: &mut Memory, name: &str, layer: &Layer<'_>) {
    let x = &memory.x[..layer.inputs.words()];
    let mut out = [0; 128];
    bench.kernel(name, layer.inputs.count() * layer.outputs, &mut || {
        dense(layer, black_box(x), black_box(&mut out[..layer.outputs]), saturate_i16);
    });
}

fn key_value<const W: usize>(bench: &mut Bench, name: &str, block: &Attention<'_>) {
    let x = activations::<W>(&mut noise());
    let macs = [block.key, block.value].map(|layer| layer.inputs.count() * layer.outputs);
    let mut cache = KeyValueCache::<W>::new();
    bench.kernel(name, macs.iter().sum(), &mut || {
        black_box(&mut cache).push(block, black_box(&x), WINDOW, &mut ());
    });
}

fn attention<const W: usize>(bench: &mut Bench, name: &str, block: &Attention<'_>) {
    let width = block.query.outputs;
    let mut cache = KeyValueCache::<W>::new();
    let mut source = noise();
    for _ in 0..WINDOW {
        cache.push(block, &activations(&mut source), WINDOW, &mut ());
    }
    let x = activations::<W>(&mut source);
    let mut out = [0; 2 * EMBED];
    let macs = 2 * width * width + 2 * width * WINDOW;
    bench.kernel(name, macs, &mut || {
        let (x, out) = black_box((&x, &mut out[..width]));
        attend(block, x, black_box(&cache), out, &mut ());
    });
}

fn features(bench: &mut Bench) {
    let samples = samples();
    let mut front_end = XlFrontEnd::new();
    bench.kernel("XlFrontEnd::push, 33 samples", 0, &mut || {
        black_box(&mut front_end).push(black_box(&samples))
    });
    bench.kernel("XlFrontEnd::log_mel", 0, &mut || _ = black_box(black_box(&mut front_end).log_mel()));
    let mut window = [0; XL_WINDOW];
    window.iter_mut().zip(noise()).for_each(|(x, noise)| *x = i32::from(noise));
    let mut work = Work::default();
    bench.kernel("Hann window and real FFT 128", 0, &mut || {
        windowed_fft(black_box(&window), &mut work, |_, bin| _ = black_box(bin));
    });
    let frame = frame();
    bench.kernel("ContactSummary::new", 0, &mut || _ = black_box(ContactSummary::new(black_box(&frame))));
    let mut pad = PiezoFrontEnd::new();
    let mut cells = [[0; PIEZO_CHANNELS]; TAXELS];
    bench.kernel("PiezoFrontEnd::push", 0, &mut || {
        let cells = black_box(&mut cells);
        pad.push(black_box(frame.counts()), |index, cell| cells[index] = cell);
    });
}

fn wire(bench: &mut Bench) {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let message = SlipMessage::default();
    bench.kernel("slip message to its CAN frame", 0, &mut || {
        black_box(transmitter.slip(black_box(&message)));
    });
    let (frame, samples) = (frame(), samples());
    let input = SensorInput { piezo: Some(&frame), xl: Some(&samples), xl_end: 0 };
    let raw = RawFrame { timestamp_us: 0, sequence: 0, sensor: 0, health: 0, input };
    let mut buffer = RawBuffer::new();
    bench.kernel("raw message to its CAN frames", 0, &mut || {
        transmitter.raw(black_box(&raw), &mut buffer).for_each(|frame| _ = black_box(frame));
    });
}

/// A contact over the whole pad.
fn frame() -> PiezoFrame {
    let mut counts = [0; TAXELS];
    counts.iter_mut().zip(noise()).for_each(|(count, x)| *count = x.unsigned_abs());
    PiezoFrame::from_scan(counts)
}

fn samples() -> [XlSample; BATCH] {
    let mut samples = [[0; 3]; BATCH];
    samples.as_flattened_mut().iter_mut().zip(noise()).for_each(|(sample, x)| *sample = x);
    samples
}

fn activations<const W: usize>(source: &mut impl Iterator<Item = i16>) -> Activations<W> {
    let mut x = Activations::new();
    x.values_mut().iter_mut().zip(source).for_each(|(x, noise)| *x = noise);
    x
}

fn words() -> impl Iterator<Item = u32> {
    let mut source = noise();
    core::iter::repeat_with(move || pair(source.next().unwrap_or(0), source.next().unwrap_or(0)))
}

/// Numbers of any size, the same in every run: the generator of Numerical Recipes.
fn noise() -> impl Iterator<Item = i16> {
    let mut state = 1u32;
    core::iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) as i16
    })
}
