//! The kernels of a target against the portable ones: random and extreme input,
//! sums that wrap included. The emulated microcontroller runs it, and so does a test on this computer.

use slipsense::simd::{self, LANES, LayerParams, Map, MapMut, MapShape, portable};

/// Words of the largest map: 8×8×32 with its border.
const MAP: usize = 10 * 10 * 16;
/// Words of the largest weights: 3×3×16 for 32 outputs, four numbers for three.
const WEIGHTS: usize = 12 * 8 * 32;
/// Words of the largest strip: four rows of 8×8×16.
const STRIP: usize = 4 * 10 * 8;
/// Bias and multiplier of N outputs.
const OUTPUTS: usize = 32;
/// Frames of the longest window.
const ROWS: usize = 60;

pub const ROUNDS: u32 = 400;

#[derive(Clone, Copy, Debug)]
pub struct Kernels {
    /// As [`portable::conv_relu_pool`].
    pub conv_relu_pool: fn(LayerParams<'_>, Map<'_>, MapMut<'_>, &mut [u32]),
    /// As [`portable::dense`].
    pub dense: fn(&[u32], LayerParams<'_>, &mut [i32]),
    /// As [`portable::dots`].
    pub dots: fn(&[u32], &[u32], usize, &mut [i32]),
    /// As [`portable::weighted_sums`].
    pub weighted_sums: fn(&[i32], &[u32], usize) -> [i32; 8],
}

impl Kernels {
    /// What the network runs here.
    pub const HERE: Self = Self {
        conv_relu_pool: simd::conv_relu_pool,
        dense: simd::dense,
        dots: simd::dots,
        weighted_sums: simd::weighted_sums,
    };
    /// What it runs on a computer without AVX2.
    #[cfg(all(target_arch = "x86_64", target_feature = "sse2"))]
    pub const SSE2: Self =
        Self { conv_relu_pool: simd::x86::sse2::conv_relu_pool, dense: simd::x86::sse2::dense, ..Self::HERE };
}

/// What a kernel was asked, and how often it answered otherwise than the portable one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Compared {
    /// Of `simd`.
    pub kernel: &'static str,
    pub calls: u32,
    /// Calls with a result that differs in any bit.
    pub differing: u32,
}

#[derive(Debug)]
pub struct Scratch {
    x: [u32; MAP],
    weights: [u32; WEIGHTS],
    bias: [i32; OUTPUTS],
    multiplier: [i32; OUTPUTS],
    out: [u32; MAP],
    expected: [u32; MAP],
    strip: [u32; STRIP],
}

impl Scratch {
    pub const fn new() -> Self {
        Self {
            x: [0; MAP],
            weights: [0; WEIGHTS],
            bias: [0; OUTPUTS],
            multiplier: [0; OUTPUTS],
            out: [0; MAP],
            expected: [0; MAP],
            strip: [0; STRIP],
        }
    }
}

impl Default for Scratch {
    fn default() -> Self {
        Self::new()
    }
}

/// Maps that a convolution can take, as side and words per cell. The last is one that there is no assembly for.
const MAPS: [(usize, usize); 8] = [(32, 1), (16, 2), (16, 4), (8, 2), (8, 4), (8, 6), (8, 8), (4, 3)];

/// Compare each of `kernels` and every shape so often.
pub fn compare(kernels: Kernels, rounds: u32, scratch: &mut Scratch, mut report: impl FnMut(Compared)) {
    let mut dice = Dice(1);
    let report = &mut report;
    count(report, "conv_relu_pool", rounds, |round| {
        MAPS.map(|map| conv_is_equal(kernels, scratch, &mut dice, round, map))
    });
    count(report, "dense", rounds, |round| {
        // Whole rounds of the assembly, its longest, and what it leaves to the portable form.
        [0, 1, 3, 4, 8, 20, 40, 128, 252, 256, 260]
            .map(|words| dense_is_equal(kernels, scratch, &mut dice, round, words))
    });
    count(report, "dots", rounds, |round| {
        [(1, 16), (3, 16), (4, 16), (8, 16), (4, 9), (16, 16)]
            .map(|shape| dots_are_equal(kernels, scratch, &mut dice, round, shape))
    });
    count(report, "weighted_sums", rounds, |round| {
        [5, 16, 32, 64].map(|stride| sums_are_equal(kernels, scratch, &mut dice, round, stride))
    });
}

/// Report a kernel whose calls were equal, or were not, in each of the rounds.
fn count<const N: usize>(
    report: &mut dyn FnMut(Compared),
    kernel: &'static str,
    rounds: u32,
    are_equal: impl FnMut(u32) -> [bool; N],
) {
    let differing = (0..rounds).flat_map(are_equal).filter(|is_equal| !is_equal).count() as u32;
    report(Compared { kernel, calls: rounds * N as u32, differing });
}

fn conv_is_equal(
    kernels: Kernels,
    scratch: &mut Scratch,
    dice: &mut Dice,
    round: u32,
    (side, pairs): (usize, usize),
) -> bool {
    let outputs = [4, 8, 32][dice.below(if side == 32 { 2 } else { 3 })];
    let from = MapShape { side, pairs, border: 1 };
    // As the network's: what comes out of the smallest goes to a dense layer. Assembly leaves others to the portable
    // form.
    let border = usize::from(side > 8) ^ usize::from(dice.below(8) == 0);
    let to = MapShape { side: side / 2, pairs: outputs / 2, border };
    let Scratch { x, weights, bias, multiplier, out, expected, strip } = scratch;
    dice.fill(round, x);
    dice.fill(round / 2, weights);
    scales(dice, bias, multiplier);
    // The border of the output must be left as it is.
    dice.fill(1, out);
    *expected = *out;
    let weights = &weights[..outputs / LANES * 12 * pairs * LANES];
    let layer = LayerParams { weights, bias: &bias[..outputs], multiplier: &multiplier[..outputs] };
    let x = Map { words: &x[..from.len()], shape: from };
    (kernels.conv_relu_pool)(layer, x, MapMut { words: &mut out[..to.len()], shape: to }, strip);
    portable::conv_relu_pool(layer, x, MapMut { words: &mut expected[..to.len()], shape: to }, strip);
    out == expected
}

fn dense_is_equal(
    kernels: Kernels,
    scratch: &mut Scratch,
    dice: &mut Dice,
    round: u32,
    words: usize,
) -> bool {
    let Scratch { x, weights, bias, multiplier, .. } = scratch;
    dice.fill(round, &mut x[..words]);
    let outputs = LANES * (1 + dice.below(2)) + dice.below(LANES);
    dice.fill(round / 2, weights);
    scales(dice, bias, multiplier);
    let weights = &weights[..(2 * LANES * words).min(WEIGHTS)];
    let layer = LayerParams { weights, bias, multiplier };
    let mut found = [0; 3 * LANES];
    let mut expected = found;
    (kernels.dense)(&x[..words], layer, &mut found[..outputs]);
    portable::dense(&x[..words], layer, &mut expected[..outputs]);
    found == expected
}

/// Small enough that results are not all cut off, and any.
fn scales(dice: &mut Dice, bias: &mut [i32], multiplier: &mut [i32]) {
    for (bias, multiplier) in bias.iter_mut().zip(multiplier) {
        let shift = dice.below(32);
        (*bias, *multiplier) = (dice.next() as i32 >> dice.below(20), (dice.next() >> 1) as i32 >> shift);
    }
}

fn dots_are_equal(
    kernels: Kernels,
    scratch: &mut Scratch,
    dice: &mut Dice,
    round: u32,
    (words, stride): (usize, usize),
) -> bool {
    let Scratch { x, weights, .. } = scratch;
    let rows = dice.below(ROWS + 1);
    dice.fill(round, &mut x[..ROWS * stride]);
    dice.fill(round / 2, &mut weights[..words]);
    let mut found = [0; ROWS];
    let mut expected = [0; ROWS];
    (kernels.dots)(&weights[..words], &x[..ROWS * stride], stride, &mut found[..rows]);
    portable::dots(&weights[..words], &x[..ROWS * stride], stride, &mut expected[..rows]);
    found == expected
}

fn sums_are_equal(
    kernels: Kernels,
    scratch: &mut Scratch,
    dice: &mut Dice,
    round: u32,
    stride: usize,
) -> bool {
    let Scratch { x, weights, .. } = scratch;
    let rows = dice.below(MAP / stride).min(ROWS);
    let mut factors = [0; ROWS];
    dice.fill(round, x);
    dice.fill(round / 2, weights);
    for (factor, &word) in factors.iter_mut().zip(weights.iter()) {
        *factor = word as i32;
    }
    (kernels.weighted_sums)(&factors[..rows], x, stride)
        == portable::weighted_sums(&factors[..rows], x, stride)
}

/// Numbers of any size, the same in every run: Marsaglia's xorshift.
pub(crate) struct Dice(pub(crate) u32);

impl Dice {
    pub(crate) fn next(&mut self) -> u32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 17;
        self.0 ^= self.0 << 5;
        self.0
    }

    pub(crate) fn below(&mut self, end: usize) -> usize {
        self.next() as usize % end.max(1)
    }

    /// By turns any numbers, the ends of the range and what is beside zero, one of them everywhere, and small ones.
    fn fill(&mut self, round: u32, words: &mut [u32]) {
        const ENDS: [i16; 6] = [i16::MIN, i16::MAX, -1, 0, 1, i16::MIN + 1];
        let everywhere = simd::pair(ENDS[self.below(6)], ENDS[self.below(6)]);
        for word in words {
            *word = match round % 4 {
                0 => self.next(),
                1 => simd::pair(ENDS[self.below(6)], ENDS[self.below(6)]),
                2 => everywhere,
                _ => simd::pair((self.next() as i16) >> 9, (self.next() as i16) >> 9),
            };
        }
    }
}
