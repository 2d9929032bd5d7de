//! Which taxels a message carries.

use crate::params::{ACTIVE_TAXELS, TAXEL_COLS, TAXEL_ROWS, TAXEL_TOUCH_MIN};
use crate::sensor::{PiezoFrame, active_cols};

/// A rectangle of the grid. Taxels beside the pad are in it, but never sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// First row.
    pub first_row: u8,
    /// Rows, 0 to 32.
    pub rows: u8,
    /// First column.
    pub first_col: u8,
    /// Columns, 0 to 32.
    pub cols: u8,
}

impl Region {
    /// The whole grid.
    pub const ALL: Self = Self { first_row: 0, rows: TAXEL_ROWS as u8, first_col: 0, cols: TAXEL_COLS as u8 };
    /// No taxel.
    pub const NONE: Self = Self { first_row: 0, rows: 0, first_col: 0, cols: 0 };

    /// The smallest that holds every taxel in contact: [`TAXEL_TOUCH_MIN`] counts and more.
    pub fn around_contact(piezo: &PiezoFrame) -> Self {
        let (mut rows, mut cols) = ([TAXEL_ROWS, 0], [TAXEL_COLS, 0]);
        for (row, cells) in piezo.counts().as_chunks::<TAXEL_COLS>().0.iter().enumerate() {
            for (col, _) in cells.iter().enumerate().filter(|&(_, &count)| count >= TAXEL_TOUCH_MIN) {
                rows = [rows[0].min(row), row + 1];
                cols = [cols[0].min(col), cols[1].max(col + 1)];
            }
        }
        if rows[1] == 0 {
            return Self::NONE;
        }
        Self {
            first_row: rows[0] as u8,
            rows: (rows[1] - rows[0]) as u8,
            first_col: cols[0] as u8,
            cols: (cols[1] - cols[0]) as u8,
        }
    }

    /// First row, rows, first column, columns.
    pub const fn to_bytes(self) -> [u8; 4] {
        [self.first_row, self.rows, self.first_col, self.cols]
    }

    /// `None` if it does not lie on the grid.
    pub(super) fn from_bytes([first_row, rows, first_col, cols]: [u8; 4]) -> Option<Self> {
        let ends = [usize::from(first_row) + usize::from(rows), usize::from(first_col) + usize::from(cols)];
        let on_grid = ends[0] <= TAXEL_ROWS && ends[1] <= TAXEL_COLS;
        on_grid.then_some(Self { first_row, rows, first_col, cols })
    }

    /// The taxels of one row that are in it, as columns; empty where it does not reach.
    #[inline]
    pub fn cols(&self, row: usize) -> core::ops::Range<usize> {
        let first = usize::from(self.first_row);
        if row < first || row >= first + usize::from(self.rows) {
            return 0..0;
        }
        let (active, start) = (active_cols(row % TAXEL_ROWS), usize::from(self.first_col));
        let start_in = active.start.max(start);
        start_in..active.end.min(start + usize::from(self.cols)).max(start_in)
    }

    /// How many taxels it holds.
    pub fn taxels(&self) -> usize {
        if *self == Self::ALL {
            return ACTIVE_TAXELS;
        }
        (0..TAXEL_ROWS).map(|row| self.cols(row).len()).sum()
    }
}
