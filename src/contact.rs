//! What a pad feels, in a handful of numbers: sum, area, centre, long axis.
//!
//! The only floating point of the frame path: single precision, each operation rounded as IEEE 754
//! says, the functions from `micromath`, which computes them in software. Host and microcontroller
//! therefore agree bit for bit. The results are integers.

use micromath::F32Ext;

use crate::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_TOUCH_MIN};
use crate::sensor::PiezoFrame;

/// Contact on one pad. Taxels of fewer than [`TAXEL_TOUCH_MIN`] counts enter `sum` only. All zero
/// without a touched taxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContactSummary {
    /// Counts of the whole pad.
    pub sum: u32,
    /// Taxels touched.
    pub area: u16,
    /// Count-weighted centre, rows from row 0, 1/256 taxel.
    pub centroid_row_q8: u16,
    /// Count-weighted centre, columns from column 0, 1/256 taxel.
    pub centroid_col_q8: u16,
    /// Direction of the long axis on the pad in millimetres, −90 to 89 degrees; 0 runs along a row,
    /// positive turns from growing columns towards growing rows. Off by less than 1 degree.
    pub axis_deg: i8,
    /// `1 − short/long` axis (standard deviations), 1/256: 0 is round, 255 a line. Off by less than 2.
    pub elongation_q8: u8,
}

impl ContactSummary {
    /// Summarise one scan.
    pub fn of(frame: &PiezoFrame) -> Self {
        let mut moments = Moments::default();
        for (row, counts) in frame.counts().chunks_exact(TAXEL_COLS).enumerate() {
            for (col, &count) in counts.iter().enumerate() {
                if count >= TAXEL_TOUCH_MIN {
                    moments.add(row as i64, col as i64, count as i64);
                }
            }
        }
        let Moments { area, weight, row, col, .. } = moments;
        let mut summary = Self { sum: frame.sum(), area, ..Self::default() };
        if weight > 0 {
            // Rows and columns are below 32, so the results are below 2^13.
            summary.centroid_row_q8 = ((row * 512 + weight) / (2 * weight)) as u16;
            summary.centroid_col_q8 = ((col * 512 + weight) / (2 * weight)) as u16;
            (summary.axis_deg, summary.elongation_q8) = moments.axis();
        }
        summary
    }
}

/// Sums over the touched taxels, exact: counts below 2^12, 942 taxels, squares below 2^10.
#[derive(Default)]
struct Moments {
    area: u16,
    weight: i64,
    row: i64,
    col: i64,
    row_row: i64,
    col_col: i64,
    row_col: i64,
}

impl Moments {
    fn add(&mut self, row: i64, col: i64, count: i64) {
        self.area += 1;
        self.weight += count;
        self.row += count * row;
        self.col += count * col;
        self.row_row += count * row * row;
        self.col_col += count * col * col;
        self.row_col += count * row * col;
    }

    /// Angle of the larger principal axis and how much longer it is.
    fn axis(&self) -> (i8, u8) {
        // weight² times the covariances, below 2^56: exact, then rounded once to single precision.
        let rows = (self.weight * self.row_row - self.row * self.row) as f32 * (ROW_PITCH_MM * ROW_PITCH_MM);
        let cols = (self.weight * self.col_col - self.col * self.col) as f32 * (COL_PITCH_MM * COL_PITCH_MM);
        let both = (self.weight * self.row_col - self.row * self.col) as f32 * (ROW_PITCH_MM * COL_PITCH_MM);
        let difference = cols - rows;
        let spread = root(difference * difference + 4.0 * both * both);
        let (long, short) = (rows + cols + spread, (rows + cols - spread).max(0.0));
        if long <= 0.0 || spread <= 0.0 {
            return (0, 0);
        }
        let degrees = (0.5 * (2.0 * both).atan2(difference)).to_degrees().round() as i32;
        let axis = if degrees >= 90 { degrees - 180 } else { degrees };
        let elongation = 256.0 * (1.0 - root(short / long));
        (axis.clamp(-90, 89) as i8, elongation.clamp(0.0, 255.0) as u8)
    }
}

/// Square root: `micromath`'s is off by up to 5 %, two Newton steps make that 1e-6.
fn root(x: f32) -> f32 {
    if x <= 0.0 {
        return 0.0;
    }
    let first = F32Ext::sqrt(x);
    let second = 0.5 * (first + x / first);
    0.5 * (second + x / second)
}
