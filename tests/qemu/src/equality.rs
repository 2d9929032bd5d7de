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

/// What a kernel was asked, and how often it answered otherwise than the portable one.
#[derive(Debug)]
pub struct Compared {
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
    pub const ZEROED: Self = Self {
        x: [0; MAP],
        weights: [0; WEIGHTS],
        bias: [0; OUTPUTS],
        multiplier: [0; OUTPUTS],
        out: [0; MAP],
        expected: [0; MAP],
        strip: [0; STRIP],
    };
}

/// Maps that a convolution can take, as side and words per cell. The last is one that there is no assembly for.
const MAPS: [(usize, usize); 8] = [(32, 1), (16, 2), (16, 4), (8, 2), (8, 4), (8, 6), (8, 8), (4, 3)];
/// Words of a row of weights: whole rounds of the assembly, its longest, and what it leaves to the portable form.
const ROW_WORDS: [usize; 11] = [0, 1, 3, 4, 8, 20, 40, 128, 252, 256, 260];
/// Words of a row, and from one row to the next.
const DOTS: [(usize, usize); 6] = [(1, 16), (3, 16), (4, 16), (8, 16), (4, 9), (16, 16)];
const STRIDES: [usize; 4] = [5, 16, 32, 64];

/// Compare each kernel and every shape so often.
pub fn compare(rounds: u32, scratch: &mut Scratch, mut report: impl FnMut(Compared)) {
    let mut calls = Calls { scratch, dice: Dice(1), round: 0 };
    report(calls.count("conv_relu_pool", rounds, &MAPS, Calls::conv_is_equal));
    report(calls.count("dense", rounds, &ROW_WORDS, Calls::dense_is_equal));
    report(calls.count("dots", rounds, &DOTS, Calls::dots_are_equal));
    report(calls.count("weighted_sums", rounds, &STRIDES, Calls::sums_are_equal));
}

/// What every call needs.
struct Calls<'s> {
    scratch: &'s mut Scratch,
    dice: Dice,
    round: u32,
}

impl Calls<'_> {
    /// A kernel with each shape in each of the rounds.
    fn count<S: Copy>(
        &mut self,
        kernel: &'static str,
        rounds: u32,
        shapes: &[S],
        is_equal: fn(&mut Self, S) -> bool,
    ) -> Compared {
        let mut differing = 0;
        for round in 0..rounds {
            self.round = round;
            differing += shapes.iter().filter(|&&shape| !is_equal(self, shape)).count() as u32;
        }
        Compared { kernel, calls: rounds * shapes.len() as u32, differing }
    }

    fn conv_is_equal(&mut self, (side, pairs): (usize, usize)) -> bool {
        let Self { scratch, dice, round } = self;
        let outputs = [4, 8, 32][dice.below(if side == 32 { 2 } else { 3 })];
        let from = MapShape { side, pairs, border: 1 };
        // As the network's: what comes out of the smallest goes to a dense layer. Assembly leaves others to the
        // portable form.
        let border = usize::from(side > 8) ^ usize::from(dice.below(8) == 0);
        let to = MapShape { side: side / 2, pairs: outputs / 2, border };
        let Scratch { x, weights, bias, multiplier, out, expected, strip } = scratch;
        dice.fill(*round, x);
        dice.fill(*round / 2, weights);
        dice.scales(bias, multiplier);
        // The border of the output must be left as it is.
        dice.fill(1, out);
        *expected = *out;
        let weights = &weights[..outputs / LANES * 12 * pairs * LANES];
        let layer = LayerParams { weights, bias: &bias[..outputs], multiplier: &multiplier[..outputs] };
        let x = Map { words: &x[..from.len()], shape: from };
        simd::conv_relu_pool(layer, x, MapMut { words: &mut out[..to.len()], shape: to }, strip);
        portable::conv_relu_pool(layer, x, MapMut { words: &mut expected[..to.len()], shape: to }, strip);
        out == expected
    }

    fn dense_is_equal(&mut self, words: usize) -> bool {
        let Self { scratch: Scratch { x, weights, bias, multiplier, .. }, dice, round } = self;
        dice.fill(*round, &mut x[..words]);
        let outputs = LANES * (1 + dice.below(2)) + dice.below(LANES);
        dice.fill(*round / 2, weights);
        dice.scales(bias, multiplier);
        let weights = &weights[..(2 * LANES * words).min(WEIGHTS)];
        let layer = LayerParams { weights, bias, multiplier };
        let mut found = [0; 3 * LANES];
        let mut expected = found;
        simd::dense(&x[..words], layer, &mut found[..outputs]);
        portable::dense(&x[..words], layer, &mut expected[..outputs]);
        found == expected
    }

    fn dots_are_equal(&mut self, (words, stride): (usize, usize)) -> bool {
        let Self { scratch: Scratch { x, weights, .. }, dice, round } = self;
        let rows = dice.below(ROWS + 1);
        let (x, weights) = (&mut x[..ROWS * stride], &mut weights[..words]);
        dice.fill(*round, x);
        dice.fill(*round / 2, weights);
        let mut found = [0; ROWS];
        let mut expected = [0; ROWS];
        simd::dots(weights, x, stride, &mut found[..rows]);
        portable::dots(weights, x, stride, &mut expected[..rows]);
        found == expected
    }

    fn sums_are_equal(&mut self, stride: usize) -> bool {
        let Self { scratch: Scratch { x, weights, .. }, dice, round } = self;
        let rows = dice.below(MAP / stride).min(ROWS);
        dice.fill(*round, x);
        dice.fill(*round / 2, weights);
        let mut factors = [0; ROWS];
        factors.iter_mut().zip(weights.iter()).for_each(|(factor, &word)| *factor = word as i32);
        let factors = &factors[..rows];
        simd::weighted_sums(factors, x, stride) == portable::weighted_sums(factors, x, stride)
    }
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

    /// Small enough that results are not all cut off, and any.
    fn scales(&mut self, bias: &mut [i32], multiplier: &mut [i32]) {
        for (bias, multiplier) in bias.iter_mut().zip(multiplier) {
            let shift = self.below(32);
            (*bias, *multiplier) = (self.next() as i32 >> self.below(20), (self.next() >> 1) as i32 >> shift);
        }
    }
}
