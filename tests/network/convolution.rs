//! A convolution against the sum it stands for, indices written out, in 64 bits: exact wherever a model may go.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use slipsense::net::packing::{self, Inputs};
use slipsense::params::CONV_INPUT_MAX;
use slipsense::simd::{LayerParams, Map, MapMut, MapShape, conv_relu_pool, halves, portable};

/// A number anywhere in its range, at one end of it or the other, or at the upper end.
fn draw(kind: usize, rng: &mut ChaCha8Rng, (least, most): (i64, i64)) -> i64 {
    match kind {
        0 => rng.random_range(least..=most),
        1 => [least, most][rng.random_range(0..2)],
        _ => most,
    }
}

/// A convolution in a model's terms.
struct Case {
    channels: usize,
    side: usize,
    /// `[output][kernel row][kernel column][channel]`
    weights: Vec<Vec<i64>>,
    bias: Vec<i32>,
    multiplier: Vec<i32>,
    /// `[row][column][channel]`
    map: Vec<i64>,
    /// Around the output: with one it is cut to what a convolution takes, without to what a dense layer does.
    border: usize,
}

impl Case {
    fn inputs(&self) -> Inputs {
        Inputs::Patch { channels: self.channels, pairs: self.from().pairs }
    }

    fn from(&self) -> MapShape {
        // The first layer's maps have a word per cell, others what a block of four outputs gives.
        let pairs = if self.channels <= 2 { 1 } else { packing::pairs(self.channels) };
        MapShape { side: self.side, pairs, border: 1 }
    }

    fn to(&self) -> MapShape {
        MapShape { side: self.side / 2, pairs: packing::pairs(self.weights.len()), border: self.border }
    }

    /// As large as a model may have them: `2 · Σ|w| · 2^14 + |bias|` is at most `2^31 − 1`, and what the file has of
    /// every weight fits 16 bits.
    fn new(rng: &mut ChaCha8Rng, side: usize, channels: usize, outputs: usize) -> Self {
        let [of_weights, of_map] = [0, 1].map(|_| rng.random_range(0..3));
        let count = 9 * channels;
        let most = (65_535 / count as i64).min(i64::from(i16::MAX) / 3);
        let mut weights = vec![vec![0; count]; outputs];
        weights.iter_mut().flatten().for_each(|w| *w = draw(of_weights, rng, (-most, most)));
        let room = |row: &Vec<i64>| i64::from(i32::MAX) - (row.iter().map(|w| w.abs()).sum::<i64>() << 15);
        let rooms: Vec<i64> = weights.iter().map(room).collect();
        let bias = rooms.iter().map(|&room| rng.random_range(-room..=room) as i32 >> rng.random_range(0..20));
        let bias = bias.collect();
        let multiplier =
            (0..outputs).map(|_| rng.random_range(0..i32::MAX) >> rng.random_range(0..18)).collect();
        let most = i64::from(CONV_INPUT_MAX);
        let range = if channels <= 2 { (-most - 1, most) } else { (0, most) };
        let map = (0..side * side * channels).map(|_| draw(of_map, rng, range)).collect();
        let border = rng.random_range(0..2);
        Self { channels, side, weights, bias, multiplier, map, border }
    }

    /// Output, before the pool, of one filter at one place: requantized twice the sum, and the bias.
    fn at(&self, output: usize, row: usize, col: usize) -> i64 {
        let mut sum = i64::from(self.bias[output]);
        for (ky, kx) in (0..3).flat_map(|ky| (0..3).map(move |kx| (ky, kx))) {
            let inside = (1..=self.side).contains(&(row + ky)) && (1..=self.side).contains(&(col + kx));
            for channel in (0..self.channels).filter(|_| inside) {
                let x = self.map[((row + ky - 1) * self.side + col + kx - 1) * self.channels + channel];
                sum += 2 * x * self.weights[output][(ky * 3 + kx) * self.channels + channel];
            }
        }
        assert!(i32::try_from(sum).is_ok(), "{sum} leaves 32 bits");
        let exact = i128::from(sum) * i128::from(self.multiplier[output]) + (1 << 31);
        exact.div_euclid(1 << 32).clamp(0, self.most().into()) as i64
    }

    fn most(&self) -> i64 {
        [32_767, 16_383][self.border]
    }

    /// The map by a kernel.
    fn run(&self, kernel: impl FnOnce(LayerParams<'_>, Map<'_>, MapMut<'_>)) -> Vec<u32> {
        let (inputs, from, to) = (self.inputs(), self.from(), self.to());
        let put = |words: &mut [u32], place: usize, value: i64| {
            let value = i16::try_from(value).expect("fits 16 bits");
            words[place / 2] |= u32::from(value as u16) << (16 * (place % 2));
        };
        let mut weights = vec![0; packing::len(inputs, self.weights.len()) / 2];
        for (output, row) in self.weights.iter().enumerate() {
            for index in 0..inputs.coefficients() {
                let coefficient = inputs.coefficient(index, |input| row[input]);
                put(&mut weights, packing::place(inputs, output, index), coefficient);
            }
        }
        let mut x = vec![0; from.len()];
        for (index, &value) in self.map.iter().enumerate() {
            let (cell, channel) = (index / self.channels, index % self.channels);
            let word = from.at(cell / self.side, channel / 2, cell % self.side);
            put(&mut x, 2 * word + channel % 2, value);
        }
        let padded = |values: &[i32]| {
            let mut values = values.to_vec();
            values.resize(packing::padded_outputs(values.len()), 0);
            values
        };
        let mut out = vec![0; to.len()];
        let (bias, multiplier) = (padded(&self.bias), padded(&self.multiplier));
        let layer = LayerParams { weights: &weights, bias: &bias, multiplier: &multiplier };
        kernel(layer, Map { words: &x, shape: from }, MapMut { words: &mut out, shape: to });
        out
    }
}

#[test]
fn a_convolution_is_the_sum_it_stands_for() {
    let mut rng = ChaCha8Rng::seed_from_u64(17);
    let (mut outputs_seen, mut between) = (0, 0);
    for round in 0..240 {
        let side = [4, 8, 16, 32][round % 4];
        let channels = [1, 2, 3, 4, 8, 16][rng.random_range(0..6)];
        let outputs = [1, 4, 5, 8][rng.random_range(0..4)];
        let case = Case::new(&mut rng, side, channels, outputs);
        let mut strip = vec![0; case.from().strip()];
        let found = case.run(|layer, x, out| portable::conv_relu_pool(layer, x, out, &mut strip));
        let here = case.run(|layer, x, out| conv_relu_pool(layer, x, out, &mut strip));
        assert!(found == here, "round {round}: this computer's kernel differs");
        for (row, col) in (0..side / 2).flat_map(|row| (0..side / 2).map(move |col| (row, col))) {
            for output in 0..outputs {
                let window = [(0, 0), (0, 1), (1, 0), (1, 1)];
                let cells = window.map(|(dy, dx)| case.at(output, 2 * row + dy, 2 * col + dx));
                let expected = cells.into_iter().max().unwrap();
                let found = halves(found[case.to().at(row, output / 2, col)])[output % 2];
                assert_eq!(
                    i64::from(found),
                    expected,
                    "round {round}: row {row} column {col} output {output}"
                );
                outputs_seen += 1;
                between += usize::from((1..case.most()).contains(&expected));
            }
        }
    }
    assert!(between * 10 > outputs_seen, "too many outputs are cut off: {between} of {outputs_seen}");
}
