//! What the kernels compute, in plain Rust: run on every computer, and the reference for assembly.
//!
//! Written over [`Lanes`], four sums side by side, so that the same loops also run in the vector registers of a
//! computer (`super::x86`).

use super::{LANES, MapShape, halves, pair};
use crate::fixed::scale_q32;
use crate::net::requantize;

/// `acc + x₀·w₀ + x₁·w₁` over the halves of two words, wrapping.
#[inline]
pub const fn mla_pair(acc: i32, x: u32, w: u32) -> i32 {
    let ([x0, x1], [w0, w1]) = (halves(x), halves(w));
    acc.wrapping_add(x0 as i32 * w0 as i32).wrapping_add(x1 as i32 * w1 as i32)
}

/// Of `out.len()` rows, `stride` words apart: `out[i] = Σ query · row i`, over as many words as the query has,
/// wrapping.
#[inline]
pub fn dots(query: &[u32], rows: &[u32], stride: usize, out: &mut [i32]) {
    for (out, row) in out.iter_mut().zip(rows.chunks(stride.max(1))) {
        *out = query.iter().zip(row).fold(0, |acc, (&q, &x)| mla_pair(acc, q, x));
    }
}

/// Of as many rows as there are weights, `stride` words apart: `Σ weight · row` for the first eight numbers, of a
/// weight its low 16 bits, signed; wrapping.
#[inline]
pub fn weighted_sums(weights: &[i32], rows: &[u32], stride: usize) -> [i32; 8] {
    let mut sums = [0i32; 8];
    for (&weight, row) in weights.iter().zip(rows.chunks(stride.max(1))) {
        for (sums, &word) in sums.as_chunks_mut::<2>().0.iter_mut().zip(row) {
            for (sum, x) in sums.iter_mut().zip(halves(word)) {
                *sum = sum.wrapping_add(x as i32 * weight as i16 as i32);
            }
        }
    }
    sums
}

/// Four sums of products, wrapping: an array, or a vector register where there is one.
pub trait Lanes: Copy {
    /// Sums to start from.
    fn new(sums: [i32; LANES]) -> Self;

    /// Add the products of one word with each of four.
    fn mla(self, x: u32, w: &[u32; LANES]) -> Self;

    /// The sums.
    fn sums(self) -> [i32; LANES];
}

impl Lanes for [i32; LANES] {
    #[inline]
    fn new(sums: [i32; LANES]) -> Self {
        sums
    }

    #[inline]
    fn mla(self, x: u32, w: &[u32; LANES]) -> Self {
        core::array::from_fn(|lane| mla_pair(self[lane], x, w[lane]))
    }

    #[inline]
    fn sums(self) -> [i32; LANES] {
        self
    }
}

/// `out = (bias + Σ x·w) · multiplier`, scaled by [`scale_q32`], for as many outputs as there are blocks of four of
/// weights, biases, multipliers and `out`.
///
/// `weights`: per block for every word of `x` one word per output.
#[inline]
pub fn dense(x: &[u32], layer: (&[u32], &[i32], &[i32]), out: &mut [i32]) {
    dense_in::<[i32; LANES]>(x, layer, out);
}

/// [`dense`] in any lanes.
#[inline]
pub(super) fn dense_in<L: Lanes>(
    x: &[u32],
    (weights, bias, multiplier): (&[u32], &[i32], &[i32]),
    out: &mut [i32],
) {
    let scales = bias.as_chunks::<LANES>().0.iter().zip(multiplier.as_chunks::<LANES>().0);
    let blocks = weights.as_chunks::<LANES>().0.chunks_exact(x.len().max(1)).zip(scales);
    for (out, (weights, (bias, multiplier))) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(blocks) {
        let words = x.iter().zip(weights);
        let sums = words.fold(L::new(*bias), |lanes, (&x, w)| lanes.mla(x, w)).sums();
        *out = core::array::from_fn(|lane| scale_q32(sums[lane], multiplier[lane]));
    }
}

/// 3×3 convolution, 2×2 max-pool, then bias, requantization and ReLU: the map `x` of shape `from` (border 1) to the
/// map `out` of shape `to`, whose border is left as it is.
///
/// The pool runs on the sums: what follows is monotonic, so pooling first gives the same bits with a quarter of
/// the requantizations. Weights, bias and multiplier: four outputs after the other, as
/// [`crate::net::packing`] has them; so many outputs as `to` has channels.
pub fn conv_relu_pool(layer: (&[u32], &[i32], &[i32]), x: (&[u32], MapShape), out: (&mut [u32], MapShape)) {
    conv_relu_pool_in::<[i32; LANES]>(layer, x, out);
}

/// [`conv_relu_pool`] in any lanes.
#[inline]
pub(super) fn conv_relu_pool_in<L: Lanes>(
    (weights, bias, multiplier): (&[u32], &[i32], &[i32]),
    (x, from): (&[u32], MapShape),
    (out, to): (&mut [u32], MapShape),
) {
    let groups = 3 * from.pairs;
    let filters = weights.as_chunks::<{ 3 * LANES }>().0.chunks_exact(groups.max(1));
    let scales = bias.as_chunks::<LANES>().0.iter().zip(multiplier.as_chunks::<LANES>().0);
    for ((block, filters), (bias, multiplier)) in (0..to.pairs / 2).zip(filters).zip(scales) {
        for row in 0..to.side {
            for col in 0..to.side {
                // Row −1 and column −1 are the border.
                let top = 2 * row * from.row() + 2 * col;
                let best = tile::<L>(x.get(top..).unwrap_or_default(), from, filters);
                let cell: [i16; LANES] = core::array::from_fn(|lane| {
                    requantize::relu(scale_q32(bias[lane].wrapping_add(best[lane]), multiplier[lane]))
                });
                for (half, cell) in cell.as_chunks::<2>().0.iter().enumerate() {
                    if let Some(word) = out.get_mut(to.at(row, 2 * block + half, col)) {
                        *word = pair(cell[0], cell[1]);
                    }
                }
            }
        }
    }
}

/// The largest of four neighbouring outputs, for four filters; `x` begins at the corner of their window.
#[inline]
fn tile<L: Lanes>(x: &[u32], from: MapShape, filters: &[[u32; 3 * LANES]]) -> [i32; LANES] {
    let mut sums = [L::new([0; LANES]); 4];
    // Planes follow each other through the rows at equal distance.
    let upper = x.chunks(from.plane().max(1));
    let lower = x.get(from.row()..).unwrap_or_default().chunks(from.plane().max(1));
    for ((upper, lower), taps) in upper.zip(lower).zip(filters) {
        let (Some(&[a0, a1, a2, a3]), Some(&[b0, b1, b2, b3])) = (upper.first_chunk(), lower.first_chunk())
        else {
            break;
        };
        let [s0, s1, s2, s3] = &mut sums;
        let cells = [[a0, a1, b0, b1], [a1, a2, b1, b2], [a2, a3, b2, b3]];
        for ([x0, x1, x2, x3], w) in cells.into_iter().zip(taps.as_chunks::<LANES>().0) {
            *s0 = s0.mla(x0, w);
            *s1 = s1.mla(x1, w);
            *s2 = s2.mla(x2, w);
            *s3 = s3.mla(x3, w);
        }
    }
    let [a, b, c, d] = sums.map(L::sums);
    core::array::from_fn(|lane| a[lane].max(b[lane]).max(c[lane]).max(d[lane]))
}
