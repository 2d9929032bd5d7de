//! The taxels of one frame: each is predicted from its neighbours that came before, and the difference coded with
//! the frequencies that belong to how uneven, and how heavily pressed, the neighbourhood is.
//!
//! Nothing of the frame before is used, on purpose. It would make the taxels shorter; but then the loss of one
//! frame costs the frames that refer to it, sender and receiver need the same past, and a listener that joins waits.

use super::range::Coder;
use super::region::Region;
use super::tables::{TAXEL_CONTEXTS, TAXEL_TABLES};
use super::value::{fold, half_octaves, unfold};
use crate::params::{COUNT_MAX, TAXEL_COLS, TAXELS};

/// Code the taxels of `region`, row by row. What lies beside it, or beside the pad, must be 0 in `counts`. Gives up
/// where `keep_on`, asked after each row with the taxels coded so far, says so. `false`: given up, or a count came
/// out that no taxel has.
pub(super) fn code<C: Coder>(
    coder: &mut C,
    region: &Region,
    counts: &mut [u16; TAXELS],
    mut keep_on: impl FnMut(&C, usize) -> bool,
) -> bool {
    // The row above, with a zero at either side.
    let mut above = [0i32; TAXEL_COLS + 2];
    let (mut out_of_range, mut done) = (0, 0);
    for (row, cells) in counts.as_chunks_mut::<TAXEL_COLS>().0.iter_mut().enumerate() {
        let cols = region.cols_of(row);
        let (start, taxels) = (cols.start, cols.len());
        let Some(span) = cells.get_mut(cols) else { continue };
        let near = above.get(start..).unwrap_or(&[]);
        let mut left = 0;
        for (cell, near) in span.iter_mut().zip(near.windows(3)) {
            let &[above_left, above, above_right] = near else { continue };
            let table = table_of(left, above_left, above, above_right);
            let guess = predict(left, above_left, above);
            let difference = fold(i32::from(*cell) - guess);
            let count = guess + unfold(coder.value(table, difference));
            out_of_range |= count;
            left = count & i32::from(COUNT_MAX);
            *cell = left as u16;
        }
        done += taxels;
        for (above, &cell) in above.iter_mut().skip(1).zip(cells.iter()) {
            *above = cell.into();
        }
        if !keep_on(coder, done) {
            return false;
        }
    }
    out_of_range & !i32::from(COUNT_MAX) == 0
}

/// The median of left, above, and what a plane through the three neighbours says (as LOCO-I, Weinberger, Seroussi
/// and Sapiro 2000): the plane where the surface is smooth, the better neighbour at an edge. Within the two
/// neighbours, so within the range of a count.
#[inline]
fn predict(left: i32, above_left: i32, above: i32) -> i32 {
    let (low, high) = if left < above { (left, above) } else { (above, left) };
    (left + above - above_left).clamp(low, high)
}

/// The steps between the neighbours, and 1/32 of their sum: a pressed film is noisier, and its taxels differ.
#[inline]
fn table_of(left: i32, above_left: i32, above: i32, above_right: i32) -> &'static super::tables::Table {
    let steps = left.abs_diff(above_left) + above.abs_diff(above_left) + above_right.abs_diff(above);
    let level = (left + above_left + above + above_right) as u32 >> 5;
    let context = half_octaves(steps + level).min(TAXEL_CONTEXTS - 1);
    &TAXEL_TABLES[context]
}
