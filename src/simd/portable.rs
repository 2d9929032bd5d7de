//! The kernels in plain Rust, the reference for assembly and vector registers. Four sums lie side by side.

use super::layout::{LANES, LayerParams, Map, MapMut, MapShape, halves, pair};
use crate::fixed::{relu_i16, scale_q32};

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

/// Add the products of one word with each of four, wrapping.
#[inline]
fn mla(sums: [i32; LANES], x: u32, w: &[u32; LANES]) -> [i32; LANES] {
    core::array::from_fn(|lane| mla_pair(sums[lane], x, w[lane]))
}

/// Sum and difference of two, wrapping.
#[inline]
fn butterfly(a: [i32; LANES], b: [i32; LANES]) -> [[i32; LANES]; 2] {
    [
        core::array::from_fn(|lane| a[lane].wrapping_add(b[lane])),
        core::array::from_fn(|lane| a[lane].wrapping_sub(b[lane])),
    ]
}

/// `out = (bias + Σ x·w) · multiplier`, scaled by [`scale_q32`], for as many outputs as layer and `out` have blocks of
/// four.
#[inline]
pub fn dense(x: &[u32], layer: LayerParams<'_>, out: &mut [i32]) {
    let blocks = layer.weights.as_chunks::<LANES>().0.chunks_exact(x.len().max(1)).zip(layer.scales());
    for (out, (weights, (bias, multiplier))) in out.as_chunks_mut::<LANES>().0.iter_mut().zip(blocks) {
        let words = x.iter().zip(weights);
        let sums = words.fold(*bias, |sums, (&x, w)| mla(sums, x, w));
        *out = core::array::from_fn(|lane| scale_q32(sums[lane], multiplier[lane]));
    }
}

/// 3×3 convolution, 2×2 max-pool, then bias, requantization and ReLU: the map `x` (border 1) to the map `out`. `strip`,
/// [`MapShape::strip`] words of `x`, is scratch.
///
/// Two outputs one above the other use four rows of the map, `d0` to `d3`. For a column `g0`, `g1`, `g2` of a kernel
/// their sums of products, twice, are
///
/// ```text
/// d0·2g0 + d1·2g1 + d2·2g2 = (d1 + d2)(g0 + g1 + g2) + (d2 − d1)(g0 − g1 + g2) + (d0 − d2)·2g0
/// d1·2g0 + d2·2g1 + d3·2g2 = (d1 + d2)(g0 + g1 + g2) − (d2 − d1)(g0 − g1 + g2) + (d3 − d1)·2g2
/// ```
///
/// four products instead of six (Winograd's F(2, 3)). Sums and differences of rows are the strip, computed once for all
/// filters; those of weights are in the model file; products are summed over columns and channels before the two halves
/// are combined. All of it wraps, so a result is exact if it fits: for activations of [`crate::net::packing`]'s range
/// and a kernel that [`crate::net::Model::parse`] took.
///
/// The pool runs on the sums: what follows is monotonic, so pooling first gives the same bits with a quarter of
/// the requantizations. The layer has as many outputs as `out` has channels.
pub fn conv_relu_pool(layer: LayerParams<'_>, x: Map<'_>, out: MapMut<'_>, strip: &mut [u32]) {
    let (from, to) = (x.shape, out.shape);
    let planes = 4 * from.pairs;
    for row in 0..to.side {
        // Row −1 and column −1 are the border.
        combine_rows(x.words.get(2 * row * from.row()..).unwrap_or_default(), from, strip);
        let filters = layer.weights.as_chunks::<{ 3 * LANES }>().0.chunks_exact(planes.max(1));
        for ((block, filters), (bias, multiplier)) in (0..to.pairs / 2).zip(filters).zip(layer.scales()) {
            for col in 0..to.side {
                let best = tile(strip.get(2 * col..).unwrap_or_default(), from, filters);
                let cell: [i16; LANES] = core::array::from_fn(|lane| {
                    let scaled = scale_q32(bias[lane].wrapping_add(best[lane]), multiplier[lane]);
                    relu_i16(scaled).min(to.largest())
                });
                for (half, cell) in cell.as_chunks::<2>().0.iter().enumerate() {
                    if let Some(word) = out.words.get_mut(to.at(row, 2 * block + half, col)) {
                        *word = pair(cell[0], cell[1]);
                    }
                }
            }
        }
    }
}

/// The strip of two rows of outputs, from the four rows that `x` begins with: for every pair of channels the planes
/// `d1 + d2` and `d2 − d1`, then for every pair `d0 − d2` and `d3 − d1`; 16-bit numbers that wrap.
#[inline]
pub fn combine_rows(x: &[u32], from: MapShape, strip: &mut [u32]) {
    let plane = from.plane().max(1);
    let mut rows = x.chunks_exact(from.row().max(1));
    let (Some(d0), Some(d1), Some(d2), Some(d3)) = (rows.next(), rows.next(), rows.next(), rows.next())
    else {
        return;
    };
    let Some((inner, outer)) = strip.split_at_mut_checked(2 * from.row()) else { return };
    let two = (2 * plane).max(1);
    let planes = inner.chunks_exact_mut(two).zip(outer.chunks_exact_mut(two));
    for (index, (inner, outer)) in planes.enumerate() {
        let (Some((sum, difference)), Some((upper, lower))) =
            (inner.split_at_mut_checked(plane), outer.split_at_mut_checked(plane))
        else {
            return;
        };
        // Not zipped chunks, whose division the compiler may leave with a check for 0.
        let [d0, d1, d2, d3] =
            [d0, d1, d2, d3].map(|row| row.get(index * plane..(index + 1) * plane).unwrap_or_default());
        combine(sum, d1, d2, i16::wrapping_add);
        combine(difference, d2, d1, i16::wrapping_sub);
        combine(upper, d0, d2, i16::wrapping_sub);
        combine(lower, d3, d1, i16::wrapping_sub);
    }
}

/// `to = f(a, b)`, number by number.
#[inline]
fn combine(to: &mut [u32], a: &[u32], b: &[u32], f: impl Fn(i16, i16) -> i16) {
    let (a, b): (&[i16], &[i16]) = (bytemuck::must_cast_slice(a), bytemuck::must_cast_slice(b));
    let to: &mut [i16] = bytemuck::must_cast_slice_mut(to);
    to.iter_mut().zip(a.iter().zip(b)).for_each(|(to, (&a, &b))| *to = f(a, b));
}

/// The largest of four neighbouring outputs, for four filters; `strip` begins at the left column of their window.
#[inline]
fn tile(strip: &[u32], from: MapShape, filters: &[[u32; 3 * LANES]]) -> [i32; LANES] {
    // First the sum for the left and right output, and one for each difference.
    let mut sums = [[[0; LANES]; 2]; 2];
    let (inner, outer) = filters.split_at(filters.len() / 2);
    let mut planes = strip.chunks(from.plane().max(1));
    accumulate(&mut sums, planes.by_ref(), inner);
    // From here on of the upper and of the lower outputs.
    let [[sum0, sum1], [difference0, difference1]] = sums;
    let ([upper0, lower0], [upper1, lower1]) = (butterfly(sum0, difference0), butterfly(sum1, difference1));
    let mut sums = [[upper0, upper1], [lower0, lower1]];
    accumulate(&mut sums, planes.by_ref(), outer);
    let [[a, b], [c, d]] = sums;
    core::array::from_fn(|lane| a[lane].max(b[lane]).max(c[lane]).max(d[lane]))
}

/// Add the products of planes by turns to the one pair of sums and to the other.
#[inline(always)]
fn accumulate<'a>(
    sums: &mut [[[i32; LANES]; 2]; 2],
    planes: &mut impl Iterator<Item = &'a [u32]>,
    filters: &[[u32; 3 * LANES]],
) {
    for taps in filters.as_chunks::<2>().0 {
        for ([left, right], taps) in sums.iter_mut().zip(taps) {
            let Some(&[x0, x1, x2, x3]) = planes.next().and_then(<[u32]>::first_chunk) else { return };
            for ([a, b], w) in [[x0, x1], [x1, x2], [x2, x3]].into_iter().zip(taps.as_chunks::<LANES>().0) {
                *left = mla(*left, a, w);
                *right = mla(*right, b, w);
            }
        }
    }
}
