//! One convolution block, 3×3, 2×2 max-pool, ReLU, of eight images at once: forwards and backwards.
//!
//! The eight images lie side by side in a [`Lanes`], so every operation is one weight times eight numbers and
//! the compiler makes vector instructions of it, whatever the number of channels.

/// One value of eight images.
pub type Lanes = [f32; LANES];
/// Images side by side.
pub const LANES: usize = 8;
/// Which of the four accumulators under a pool won, per image; [`NONE`] where the ReLU cut it.
pub type Winner = [i32; LANES];

/// No gradient passes.
const NONE: i32 = 4;

#[derive(Clone, Copy, Debug)]
pub struct Shape {
    /// Cells along one side of the input, border not counted.
    pub side: usize,
    pub inputs: usize,
    pub outputs: usize,
    /// Cells of zeros around the output: 1 before another block, else 0.
    pub border: usize,
}

impl Shape {
    /// Values of the input map, its border of 1 included.
    pub const fn input_len(&self) -> usize {
        (self.side + 2) * (self.side + 2) * self.inputs
    }

    /// Values of the output map, its border included.
    pub const fn output_len(&self) -> usize {
        let padded = self.side / 2 + 2 * self.border;
        padded * padded * self.outputs
    }

    /// Pooled cells times outputs.
    pub const fn winners(&self) -> usize {
        self.side / 2 * (self.side / 2) * self.outputs
    }

    /// Numbers in a filter.
    pub const fn filter(&self) -> usize {
        9 * self.inputs
    }

    /// Where the 3×3 patch of one of the four convolution cells under a pool begins, row `ky` of the patch.
    #[inline(always)]
    const fn patch(&self, cell: (usize, usize), corner: usize, ky: usize) -> usize {
        let row = 2 * cell.0 + corner / 2 + ky;
        (row * (self.side + 2) + 2 * cell.1 + corner % 2) * self.inputs
    }

    #[inline(always)]
    const fn output_at(&self, cell: (usize, usize)) -> usize {
        let padded = self.side / 2 + 2 * self.border;
        ((cell.0 + self.border) * padded + cell.1 + self.border) * self.outputs
    }

    #[inline(always)]
    fn cells(&self) -> impl Iterator<Item = (usize, (usize, usize))> {
        let half = self.side / 2;
        (0..half * half).map(move |index| (index, (index / half, index % half)))
    }
}

#[inline(always)]
fn multiply_add(sum: &mut Lanes, x: &Lanes, factor: f32) {
    for (sum, x) in sum.iter_mut().zip(x) {
        *sum = x.mul_add(factor, *sum);
    }
}

/// `x` to `out`; filters are `[output][ky][kx][input]`. The output's border is left as it is.
#[inline(always)]
pub fn forward(
    shape: Shape,
    x: &[Lanes],
    weight: &[f32],
    bias: &[f32],
    out: &mut [Lanes],
    winner: &mut [Winner],
) {
    let run = 3 * shape.inputs;
    let x = &x[..shape.input_len()];
    for (index, cell) in shape.cells() {
        let winner = &mut winner[index * shape.outputs..][..shape.outputs];
        let out = &mut out[shape.output_at(cell)..][..shape.outputs];
        for (output, filter) in weight.chunks_exact(shape.filter()).enumerate() {
            let mut sums = [[bias[output]; LANES]; 4];
            for (ky, weights) in filter.chunks_exact(run).enumerate() {
                let patches: [&[Lanes]; 4] =
                    std::array::from_fn(|corner| &x[shape.patch(cell, corner, ky)..][..run]);
                for (at, &weight) in weights.iter().enumerate() {
                    multiply_add(&mut sums[0], &patches[0][at], weight);
                    multiply_add(&mut sums[1], &patches[1][at], weight);
                    multiply_add(&mut sums[2], &patches[2][at], weight);
                    multiply_add(&mut sums[3], &patches[3][at], weight);
                }
            }
            let (mut best, mut won) = ([0f32; LANES], [NONE; LANES]);
            for (corner, sum) in sums.iter().enumerate() {
                for lane in 0..LANES {
                    let better = sum[lane] > best[lane];
                    best[lane] = if better { sum[lane] } else { best[lane] };
                    won[lane] = if better { corner as i32 } else { won[lane] };
                }
            }
            out[output] = best;
            winner[output] = won;
        }
    }
}

/// Gradients of a block. Each is added to what is there.
pub struct Gradients<'g> {
    pub weight: &'g mut [Lanes],
    pub bias: &'g mut [Lanes],
    /// Of the input, as its map; `None` where nobody asks.
    pub x: Option<&'g mut [Lanes]>,
}

/// Sums that are kept in registers side by side.
const WIDTH: usize = 4;

/// From the gradient of the output, a map like the output.
#[inline(always)]
pub fn backward(
    shape: Shape,
    x: &[Lanes],
    weight: &[f32],
    out_gradient: &[Lanes],
    winner: &[Winner],
    gradients: &mut Gradients<'_>,
) {
    // Gradient of each of the four sums under a pool: the winner's is the output's, [cell][output][corner].
    let mut parts = vec![[[0f32; LANES]; 4]; shape.winners()];
    for (index, cell) in shape.cells() {
        let at = index * shape.outputs..(index + 1) * shape.outputs;
        let from = &out_gradient[shape.output_at(cell)..][..shape.outputs];
        for ((parts, winner), from) in parts[at.clone()].iter_mut().zip(&winner[at]).zip(from) {
            for (corner, part) in parts.iter_mut().enumerate() {
                for lane in 0..LANES {
                    part[lane] = if winner[lane] == corner as i32 { from[lane] } else { 0.0 };
                }
            }
        }
    }
    for (output, bias) in gradients.bias.iter_mut().enumerate() {
        for part in parts.iter().skip(output).step_by(shape.outputs).flatten() {
            add(bias, part);
        }
    }
    of_weight(shape, x, &parts, gradients.weight);
    if let Some(x_gradient) = &mut gradients.x {
        of_input(shape, weight, &parts, x_gradient);
    }
}

#[inline(always)]
fn add(sum: &mut Lanes, x: &Lanes) {
    for (sum, x) in sum.iter_mut().zip(x) {
        *sum += x;
    }
}

#[inline(always)]
fn is_zero(x: &Lanes) -> bool {
    x.iter().fold(0, |bits, x| bits | x.to_bits()) == 0
}

/// Each filter's numbers in turn, a few at a time, over all cells.
#[inline(always)]
fn of_weight(shape: Shape, x: &[Lanes], parts: &[[Lanes; 4]], gradient: &mut [Lanes]) {
    let run = 3 * shape.inputs;
    for (row, sums) in gradient.chunks_exact_mut(run).enumerate() {
        let (wide, rest) = sums.as_chunks_mut::<WIDTH>();
        for (chunk, sums) in wide.iter_mut().enumerate() {
            of_weights(shape, x, parts, (row / 3, row % 3, chunk * WIDTH), sums);
        }
        for (at, sums) in rest.as_chunks_mut::<1>().0.iter_mut().enumerate() {
            of_weights(shape, x, parts, (row / 3, row % 3, run / WIDTH * WIDTH + at), sums);
        }
    }
}

/// `N` numbers of one filter, from this output, row of the patch and place in the row on. `N` is known when
/// this is compiled, so the sums stay in registers.
#[inline(always)]
fn of_weights<const N: usize>(
    shape: Shape,
    x: &[Lanes],
    parts: &[[Lanes; 4]],
    (output, ky, from): (usize, usize, usize),
    sums: &mut [Lanes; N],
) {
    let mut local = *sums;
    for (index, cell) in shape.cells() {
        let parts = &parts[index * shape.outputs + output];
        for (corner, part) in parts.iter().enumerate() {
            if is_zero(part) {
                continue;
            }
            let at = shape.patch(cell, corner, ky) + from;
            let x: &[Lanes; N] = x[at..at + N].try_into().expect("as many");
            for n in 0..N {
                for lane in 0..LANES {
                    local[n][lane] = x[n][lane].mul_add(part[lane], local[n][lane]);
                }
            }
        }
    }
    *sums = local;
}

/// Each number of a cell's 4×4 neighbourhood in turn, a few channels at a time, over all filters.
#[inline(always)]
fn of_input(shape: Shape, weight: &[f32], parts: &[[Lanes; 4]], gradient: &mut [Lanes]) {
    let padded = shape.side + 2;
    for (index, cell) in shape.cells() {
        let parts = &parts[index * shape.outputs..][..shape.outputs];
        if parts.iter().flatten().all(is_zero) {
            continue;
        }
        for place in 0..16 {
            let (y, x) = (place / 4, place % 4);
            let at = ((2 * cell.0 + y) * padded + 2 * cell.1 + x) * shape.inputs;
            let (wide, rest) = gradient[at..at + shape.inputs].as_chunks_mut::<WIDTH>();
            for (chunk, sums) in wide.iter_mut().enumerate() {
                of_inputs(shape, weight, parts, (y, x, chunk * WIDTH), sums);
            }
            for (channel, sums) in rest.as_chunks_mut::<1>().0.iter_mut().enumerate() {
                of_inputs(shape, weight, parts, (y, x, shape.inputs / WIDTH * WIDTH + channel), sums);
            }
        }
    }
}

/// `N` channels from this row and column of the neighbourhood and this channel on.
#[inline(always)]
fn of_inputs<const N: usize>(
    shape: Shape,
    weight: &[f32],
    parts: &[[Lanes; 4]],
    (y, x, channel): (usize, usize, usize),
    sums: &mut [Lanes; N],
) {
    let mut local = *sums;
    for corner in 0..4 {
        // The tap of this corner's patch that lies here, if one does.
        let (ky, kx) = (y.wrapping_sub(corner / 2), x.wrapping_sub(corner % 2));
        if ky > 2 || kx > 2 {
            continue;
        }
        let tap = (3 * ky + kx) * shape.inputs + channel;
        for (part, filter) in parts.iter().zip(weight.chunks_exact(shape.filter())) {
            let part = &part[corner];
            let weight: &[f32; N] = filter[tap..tap + N].try_into().expect("as many");
            for n in 0..N {
                for lane in 0..LANES {
                    local[n][lane] = part[lane].mul_add(weight[n], local[n][lane]);
                }
            }
        }
    }
    *sums = local;
}
