//! The taxels of one frame: each is predicted from its neighbours that came before, and the difference coded with
//! the frequencies that belong to how uneven, and how heavily pressed, the neighbourhood is.
//!
//! Nothing of the frame before is used, on purpose. It would make the taxels shorter; but then the loss of one
//! frame costs the frames that refer to it, sender and receiver need the same past, and a listener that joins waits.

use super::range::{Decoder, Sink};
use super::tables::TAXEL_TABLES;
use super::value::{BySize, Table, fold, unfold};
use crate::params::{COUNT_MAX, TAXEL_COLS, TAXELS};
use crate::wire::region::Region;

/// A taxel's table goes by the step between left and above, and by their sum shifted by so much: a pressed film is
/// noisier, and its taxels differ.
const LEVEL_SHIFT: u32 = 4;

static TABLES: BySize = BySize::new(&TAXEL_TABLES);

/// Code the taxels of `region`, row by row. What lies beside it, or beside the pad, must be 0 in `counts`. Gives up
/// where `keep_on`, asked after each row with the taxels coded so far, says so; then it returns `false`.
pub(super) fn encode<S: Sink>(
    sink: &mut S,
    region: &Region,
    counts: &[u16; TAXELS],
    mut keep_on: impl FnMut(&S, usize) -> bool,
) -> bool {
    let mut values = [(&TAXEL_TABLES[0], 0); TAXEL_COLS];
    let mut above: &[u16; TAXEL_COLS] = &[0; TAXEL_COLS];
    let mut done = 0;
    for (row, cells) in counts.as_chunks().0.iter().enumerate() {
        let cols = region.cols(row);
        let (mut left, mut above_left) = (0, before(above, cols.start));
        let span = cells.get(cols.clone()).unwrap_or(&[]);
        let above_span = above.get(cols).unwrap_or(&[]);
        for ((value, &count), &above) in values.iter_mut().zip(span).zip(above_span) {
            let (table, guess) = expect(left, above_left, above.into());
            *value = (table, fold(i32::from(count) - guess));
            (left, above_left) = (count.into(), above.into());
        }
        sink.values(values.get(..span.len()).unwrap_or(&values));
        done += span.len();
        above = cells;
        if !keep_on(sink, done) {
            return false;
        }
    }
    true
}

/// The reverse, where `counts` are 0. `false`: a count came out that no taxel has.
pub(super) fn decode(decoder: &mut Decoder<'_>, region: &Region, counts: &mut [u16; TAXELS]) -> bool {
    let mut above: &[u16; TAXEL_COLS] = &[0; TAXEL_COLS];
    let mut all = 0;
    for (row, cells) in counts.as_chunks_mut().0.iter_mut().enumerate() {
        let cols = region.cols(row);
        let (mut left, mut above_left) = (0, before(above, cols.start));
        let span = cells.get_mut(cols.clone()).unwrap_or_default();
        for (cell, &above) in span.iter_mut().zip(above.get(cols).unwrap_or(&[])) {
            let (table, guess) = expect(left, above_left, above.into());
            let count = guess + unfold(decoder.value(table));
            all |= count;
            *cell = count as u16 & COUNT_MAX;
            (left, above_left) = ((*cell).into(), above.into());
        }
        above = cells;
    }
    all & !i32::from(COUNT_MAX) == 0
}

/// The count before a column; 0 before the first.
fn before(row: &[u16; TAXEL_COLS], col: usize) -> i32 {
    col.checked_sub(1).and_then(|col| row.get(col)).map_or(0, |&count| count.into())
}

/// What the neighbours say of a taxel: its table, and what its count may be.
///
/// The guess is three quarters of the plane through the neighbours and one of the mean of left and above, rounded
/// down: the plane alone takes over three times the noise of one taxel, and the mean misses the slope. From 0 to
/// 1.5 * 4095.
#[inline(always)]
fn expect(left: i32, above_left: i32, above: i32) -> (&'static Table, i32) {
    if left | above_left | above == 0 {
        // Half of all taxels.
        return (&TAXEL_TABLES[0], 0);
    }
    let size = 1 + left.abs_diff(above) + ((left + above) as u32 >> LEVEL_SHIFT);
    (TABLES.get(size), ((3 * (left + above) - 2 * above_left) >> 2).max(0))
}
