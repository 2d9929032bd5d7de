//! The taxel encoder's three convolution blocks for training, by hand: the tensor library's convolution is
//! made for maps with more channels.
//!
//! Images are taken in groups of eight ([`block`]), groups in a fixed number of jobs whose gradients are added
//! in order: the same result on any number of threads.

mod block;

use rayon::prelude::*;
use slipsense::params::{PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};

use self::block::{Gradients, LANES, Lanes, Shape, Winner};

/// Real value of one count at the first convolution, and of one unit of its change.
pub const PIEZO_INPUT_SCALE: f32 = 1.0 / 256.0;
/// Numbers of one image: count and change of every taxel.
pub const IMAGE: usize = TAXELS * PIEZO_CHANNELS;

/// The blocks' names, from the input on.
pub const LAYERS: [&str; BLOCKS] = ["piezo.conv1", "piezo.conv2", "piezo.conv3"];
const BLOCKS: usize = 3;
/// Sums of gradients that are kept apart.
const JOBS: usize = 16;

/// Filters `[output][ky][kx][input]` and biases of the blocks, or their gradients.
#[derive(Clone, Debug, Default)]
pub struct Filters<T = f32> {
    /// One run of numbers per block.
    pub weight: [Vec<T>; BLOCKS],
    /// One number per output.
    pub bias: [Vec<T>; BLOCKS],
}

impl Filters {
    fn shapes(&self) -> [Shape; BLOCKS] {
        const { assert!(TAXEL_ROWS == TAXEL_COLS, "the maps are square") };
        let mut inputs = PIEZO_CHANNELS;
        std::array::from_fn(|block| {
            let outputs = self.bias[block].len();
            let border = usize::from(block + 1 < BLOCKS);
            let shape = Shape { side: TAXEL_ROWS >> block, inputs, outputs, border };
            inputs = outputs;
            shape
        })
    }

    /// Numbers that leave the last block for one image: row, column, channel.
    pub fn features(&self) -> usize {
        self.shapes()[BLOCKS - 1].output_len()
    }
}

/// What a forward pass leaves for the backward one.
pub type Tape = Vec<Group>;

/// Of eight images.
#[derive(Debug)]
pub struct Group {
    /// Input of every block but the first.
    maps: Vec<Vec<Lanes>>,
    winners: [Vec<Winner>; BLOCKS],
}

/// Eight images, or the last few, as the map that enters the first block.
fn input_map(shape: Shape, images: &[i16]) -> Vec<Lanes> {
    let mut map = vec![[0.0; LANES]; shape.input_len()];
    let row_len = TAXEL_COLS * PIEZO_CHANNELS;
    for (lane, image) in images.chunks_exact(IMAGE).enumerate() {
        for (row, values) in image.chunks_exact(row_len).enumerate() {
            let at = ((row + 1) * (shape.side + 2) + 1) * PIEZO_CHANNELS;
            for (cell, &value) in map[at..at + row_len].iter_mut().zip(values) {
                cell[lane] = f32::from(value) * PIEZO_INPUT_SCALE;
            }
        }
    }
    map
}

/// Features of every image, `[image][feature]`, and what the backward pass needs. An image has [`IMAGE`] numbers.
pub fn forward(filters: &Filters, images: &[i16]) -> (Vec<f32>, Tape) {
    let shapes = filters.shapes();
    let width = filters.features();
    let mut features = vec![0.0; images.len() / IMAGE * width];
    let arch = pulp::Arch::new();
    let groups = images
        .par_chunks(LANES * IMAGE)
        .zip(features.par_chunks_mut(LANES * width))
        .map(|(images, features)| arch.dispatch(ForwardGroup { filters, shapes: &shapes, images, features }));
    let tape = groups.collect();
    (features, tape)
}

/// Compiled once per vector unit: a closure would not be inlined to where the instructions are chosen.
struct ForwardGroup<'a> {
    filters: &'a Filters,
    shapes: &'a [Shape; BLOCKS],
    images: &'a [i16],
    features: &'a mut [f32],
}

impl pulp::NullaryFnOnce for ForwardGroup<'_> {
    type Output = Group;

    #[inline(always)]
    fn call(self) -> Group {
        let Self { filters, shapes, images, features } = self;
        let mut winners = shapes.map(|shape| vec![[0; LANES]; shape.winners()]);
        let mut x = input_map(shapes[0], images);
        let mut maps = Vec::with_capacity(BLOCKS);
        for (block, &shape) in shapes.iter().enumerate() {
            let (weight, bias) = (&filters.weight[block], &filters.bias[block]);
            let mut out = vec![[0.0; LANES]; shape.output_len()];
            block::forward(shape, &x, weight, bias, &mut out, &mut winners[block]);
            maps.push(std::mem::replace(&mut x, out));
        }
        for (lane, features) in features.chunks_exact_mut(x.len()).enumerate() {
            for (feature, value) in features.iter_mut().zip(&x) {
                *feature = value[lane];
            }
        }
        Group { maps: maps.split_off(1), winners }
    }
}

/// Gradients of filters and biases, from those of the features, `[image][feature]`.
pub fn backward(filters: &Filters, images: &[i16], tape: &[Group], feature_gradient: &[f32]) -> Filters {
    let shapes = filters.shapes();
    let width = filters.features();
    let per_job = tape.len().div_ceil(JOBS).max(1);
    let arch = pulp::Arch::new();
    let jobs: Vec<Sums> = tape
        .par_chunks(per_job)
        .zip(images.par_chunks(per_job * LANES * IMAGE))
        .zip(feature_gradient.par_chunks(per_job * LANES * width))
        .map(|((groups, images), gradients)| {
            let mut sums = Sums::zeros(&shapes);
            let gradients = gradients.chunks(LANES * width);
            for ((group, images), gradients) in groups.iter().zip(images.chunks(LANES * IMAGE)).zip(gradients)
            {
                let sums = &mut sums;
                arch.dispatch(BackwardGroup { filters, shapes: &shapes, group, images, gradients, sums });
            }
            sums
        })
        .collect();
    let mut total = Sums::zeros(&shapes);
    jobs.iter().for_each(|job| total.add(job));
    total.flat()
}

/// As [`ForwardGroup`].
struct BackwardGroup<'a> {
    filters: &'a Filters,
    shapes: &'a [Shape; BLOCKS],
    group: &'a Group,
    images: &'a [i16],
    /// Of the features, `[image][feature]`.
    gradients: &'a [f32],
    sums: &'a mut Sums,
}

impl pulp::NullaryFnOnce for BackwardGroup<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { filters, shapes, group, images, gradients: feature_gradient, sums } = self;
        let mut gradient = vec![[0.0; LANES]; shapes[BLOCKS - 1].output_len()];
        for (lane, features) in feature_gradient.chunks_exact(gradient.len()).enumerate() {
            for (cell, &value) in gradient.iter_mut().zip(features) {
                cell[lane] = value;
            }
        }
        let input = input_map(shapes[0], images);
        for block in (0..BLOCKS).rev() {
            let shape = shapes[block];
            let x = if block == 0 { &input } else { &group.maps[block - 1] };
            let mut x_gradient = (block > 0).then(|| vec![[0.0; LANES]; shape.input_len()]);
            let mut gradients = Gradients {
                weight: &mut sums.weight[block],
                bias: &mut sums.bias[block],
                x: x_gradient.as_deref_mut(),
            };
            let weight = &filters.weight[block];
            block::backward(shape, x, weight, &gradient, &group.winners[block], &mut gradients);
            gradient = x_gradient.unwrap_or_default();
        }
    }
}

/// Sums of gradients, the eight images still apart.
type Sums = Filters<Lanes>;

impl Sums {
    fn zeros(shapes: &[Shape; BLOCKS]) -> Self {
        Self {
            weight: shapes.map(|shape| vec![[0.0; LANES]; shape.outputs * shape.filter()]),
            bias: shapes.map(|shape| vec![[0.0; LANES]; shape.outputs]),
        }
    }

    fn add(&mut self, other: &Self) {
        let mine = self.weight.iter_mut().chain(&mut self.bias).flatten().flatten();
        let others = other.weight.iter().chain(&other.bias).flatten().flatten();
        mine.zip(others).for_each(|(mine, other)| *mine += other);
    }

    fn flat(&self) -> Filters {
        let sums = |of: &[Vec<Lanes>; BLOCKS]| {
            of.each_ref().map(|block| block.iter().map(|lanes| lanes.iter().sum()).collect())
        };
        Filters { weight: sums(&self.weight), bias: sums(&self.bias) }
    }
}
