//! The kernels to be measured and how each is called. A kernel that changes its signature is adapted here and
//! nowhere else.

use core::hint::black_box;

use slipsense::contact::ContactSummary;
use slipsense::features::XlFrontEnd;
use slipsense::features::fft::real_fft;
use slipsense::features::pad_cells::PadCells;
use slipsense::fixed::{STANDARD_FRAC_BITS, standardise};
use slipsense::net::Model;
use slipsense::net::attention::{KeyValue, KeyValueCache, attend};
use slipsense::net::conv::{MapShape, conv3x3_relu_pool};
use slipsense::net::dense::dense;
use slipsense::net::layer_norm::add_and_norm;
use slipsense::net::model::{Attention, Layer};
use slipsense::net::requantize;
use slipsense::net::softmax::softmax_base2;
use slipsense::params::limits::{EMBED, WINDOW};
use slipsense::params::{PIEZO_CHANNELS, TAXELS, XL_WINDOW};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{NodeId, RawBuffer, RawFrame, SlipMessage, Transmitter};

use crate::emulated::Bench;

/// Networks whose layers are measured.
pub struct Models {
    /// The one in use.
    pub shipped: Model<'static>,
    /// Of the widths that peers are measured at.
    pub reference: Model<'static>,
    /// Its second convolution has one input channel.
    pub one_channel: Model<'static>,
}

/// Accelerometer samples of a frame, rounded.
const BATCH: usize = 33;
/// Activations of the largest map, 32×32×8 with its border.
const MAP: usize = 34 * 34 * 8;
const FUSED: usize = 2 * EMBED;

/// Measure everything.
pub fn measure(bench: &mut Bench, models: &Models) {
    reference(bench, models);
    shipped(bench, &models.shipped);
    features(bench);
    wire(bench);
}

/// The shapes that the literature and the peers are measured at.
fn reference(bench: &mut Bench, models: &Models) {
    let Model { conv: [_, conv2, conv3], piezo_dense, cross_piezo, temporal, .. } = &models.reference;
    let [_, one_channel, _] = &models.one_channel.conv;
    conv(bench, "conv 3x3 32x32x1->8, ReLU, pool", one_channel, 32, 1);
    conv(bench, "conv 3x3 16x16x8->16, ReLU, pool", conv2, 16, 8);
    conv(bench, "conv 3x3 8x8x16->32, ReLU, pool", conv3, 8, 16);
    // A model's embedding is no wider than 64: the outputs are made in two halves.
    dense_halves(bench, "dense 512->128", [piezo_dense, &models.one_channel.piezo_dense]);
    layer(bench, "dense 128->128", &temporal.query);
    attention::<EMBED>(bench, "attention 64-d, 4 heads, 60 keys, projections and norm", cross_piezo);

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
    let (x, context) = (activations::<EMBED>(), activations::<EMBED>());
    bench.kernel("LayerNorm 64 after dense 64->64 and residual", EMBED * EMBED, &mut || {
        let (x, context) = black_box((&x, &context));
        add_and_norm(&cross_piezo.out, context, x, &cross_piezo.norm, black_box(&mut out), |_| {});
    });
}

/// Every layer of the network in use.
fn shipped(bench: &mut Bench, model: &Model<'static>) {
    let Model { conv: [conv1, conv2, conv3], piezo_dense, xl: [xl_conv, mix1, mix2], .. } = model;
    let [c1, c2, _] = model.dims.conv_channels;
    conv(bench, "shipped: conv1", conv1, 32, PIEZO_CHANNELS);
    conv(bench, "shipped: conv2", conv2, 16, c1);
    conv(bench, "shipped: conv3", conv3, 8, c2);
    layer(bench, "shipped: dense of the pad", piezo_dense);
    layer(bench, "shipped: xl.conv", xl_conv);
    layer(bench, "shipped: xl.mix1", mix1);
    layer(bench, "shipped: xl.mix2", mix2);
    key_value::<EMBED>(bench, "shipped: key and value of a cross-attention", &model.cross_piezo);
    attention::<EMBED>(bench, "shipped: a cross-attention", &model.cross_piezo);
    key_value::<FUSED>(bench, "shipped: key and value over time", &model.temporal);
    attention::<FUSED>(bench, "shipped: attention over time", &model.temporal);
    layer(bench, "shipped: head", &model.head);
}

fn conv(bench: &mut Bench, name: &str, layer: &Layer<'_>, side: usize, channels: usize) {
    let from = MapShape { side, channels, border: 1 };
    let to = MapShape { side: side / 2, channels: layer.outputs, border: 1 };
    let x = activations::<MAP>();
    let mut out = [0; MAP];
    bench.kernel(name, side * side * layer.inputs * layer.outputs, &mut || {
        conv3x3_relu_pool(layer, black_box(&x[..from.len()]), from, black_box(&mut out[..to.len()]), to);
    });
}

fn layer(bench: &mut Bench, name: &str, layer: &Layer<'_>) {
    let x = activations::<MAP>();
    let mut out = [0; MAP];
    bench.kernel(name, layer.inputs * layer.outputs, &mut || {
        dense(layer, black_box(&x[..layer.inputs]), black_box(&mut out[..layer.outputs]), requantize::signed);
    });
}

fn dense_halves(bench: &mut Bench, name: &str, halves: [&Layer<'_>; 2]) {
    let x = activations::<MAP>();
    let mut out = [0; MAP];
    let macs = halves.map(|half| half.inputs * half.outputs).iter().sum();
    bench.kernel(name, macs, &mut || {
        let (first, second) = black_box(&mut out).split_at_mut(halves[0].outputs);
        for (half, out) in halves.into_iter().zip([first, second]) {
            dense(half, black_box(&x[..half.inputs]), &mut out[..half.outputs], requantize::signed);
        }
    });
}

fn key_value<const D: usize>(bench: &mut Bench, name: &str, block: &Attention<'_>) {
    let x = activations::<D>();
    let macs = block.key.inputs * block.key.outputs + block.value.inputs * block.value.outputs;
    bench.kernel(name, macs, &mut || {
        black_box(KeyValue::<D>::project(block, black_box(&x[..block.key.inputs]), &mut ()));
    });
}

fn attention<const D: usize>(bench: &mut Bench, name: &str, block: &Attention<'_>) {
    let width = block.query.outputs;
    let mut cache = KeyValueCache::<D>::new(WINDOW);
    let mut source = noise();
    for _ in 0..WINDOW {
        let mut x = [0; D];
        x.iter_mut().zip(&mut source).for_each(|(x, noise)| *x = noise);
        cache.push(KeyValue::project(block, &x[..width], &mut ()));
    }
    let x = activations::<D>();
    let mut out = [0; D];
    let macs = 2 * width * width + 2 * width * WINDOW;
    bench.kernel(name, macs, &mut || {
        let (x, out) = black_box((&x[..width], &mut out[..width]));
        attend(block, x, black_box(&cache).newest_first(), out, &mut ());
    });
}

fn features(bench: &mut Bench) {
    let samples = samples();
    let mut front_end = XlFrontEnd::new();
    bench.kernel("XlFrontEnd::push, 33 samples", 0, &mut || {
        black_box(&mut front_end).push(black_box(&samples))
    });
    bench.kernel("XlFrontEnd::log_mel", 0, &mut || _ = black_box(black_box(&front_end).log_mel()));
    let window: [i32; XL_WINDOW] = activations::<XL_WINDOW>().map(i32::from);
    bench.kernel("real FFT 128", 0, &mut || _ = black_box(real_fft(black_box(&window))));
    let frame = frame();
    bench.kernel("ContactSummary::of", 0, &mut || _ = black_box(ContactSummary::of(black_box(&frame))));
    let mut pad = PadCells::new();
    let mut cells = [[0; PIEZO_CHANNELS]; TAXELS];
    bench.kernel("PadCells::push", 0, &mut || {
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
    let input = SensorInput { piezo: Some(&frame), xl: Some(&samples) };
    let raw = RawFrame { timestamp_us: 0, sequence: 0, sensor: 0, health: 0, input, xl_end: 0 };
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

fn activations<const N: usize>() -> [i16; N] {
    let mut x = [0; N];
    x.iter_mut().zip(noise()).for_each(|(x, noise)| *x = noise);
    x
}

/// Numbers of any size, the same in every run: the generator of Numerical Recipes.
pub fn noise() -> impl Iterator<Item = i16> {
    let mut state = 1u32;
    core::iter::repeat_with(move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 16) as i16
    })
}
