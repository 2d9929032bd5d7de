//! What a pad feels, in a handful of numbers: sum, area, centre, long axis.
//!
//! The only floating point of the frame path: single precision, each operation rounded as IEEE 754 says, the functions
//! from `micromath`, in software. Host and microcontroller therefore agree bit for bit. The results are integers.

use micromath::F32Ext;

use crate::fixed::Q;
use crate::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_TOUCH_MIN};
use crate::sensor::{PiezoFrame, pair, sum_halves};

/// Contact on one pad. Taxels of fewer than [`TAXEL_TOUCH_MIN`] counts enter `sum` only. All zero
/// without a touched taxel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ContactSummary {
    /// Counts of the whole pad.
    pub sum: u32,
    /// Taxels touched.
    pub area: u16,
    /// Count-weighted centre, rows from row 0.
    pub centroid_row: Q<u16, 8>,
    /// Count-weighted centre, columns from column 0.
    pub centroid_col: Q<u16, 8>,
    /// Direction of the long axis on the pad in millimetres, −90 to 89 degrees; 0 runs along a row,
    /// positive turns from growing columns towards growing rows. Off by less than 1 degree.
    pub axis_deg: i8,
    /// `1 − short/long` axis (standard deviations): 0 is round, 255/256 a line. Off by less than 2/256.
    pub elongation: Q<u8, 8>,
}

impl ContactSummary {
    /// Summarise one scan.
    pub fn new(frame: &PiezoFrame) -> Self {
        let mut moments = Moments::default();
        let (mut sum, mut touched) = (0, 0);
        for (row, pairs) in frame.rows().enumerate() {
            let cells = Row::new(pairs);
            sum += sum_halves(cells.all);
            touched += cells.touched;
            moments.add(row as u32, &cells);
        }
        let Moments { weight, row, col, .. } = moments;
        let mut summary = Self { sum, area: sum_halves(touched) as u16, ..Self::default() };
        if weight > 0 {
            summary.centroid_row = mean(row, weight);
            summary.centroid_col = mean(col, weight);
            (summary.axis_deg, summary.elongation) = moments.axis();
        }
        summary
    }
}

/// `round(256 · moment / weight)` of a mean below 2^5: below 2^13.
fn mean(moment: u32, weight: u32) -> Q<u16, 8> {
    // Where nothing weighs there is no mean, and nobody asks; the division is never by zero.
    let weight = weight.max(1);
    // weight < 2^22, so that 256 times the remainder fits u32. Half of an odd weight is cut, which changes nothing:
    // 512 · rest + weight is then odd, and 2 · weight goes as often into one less.
    let (whole, rest) = (moment / weight, moment % weight);
    Q::from_bits((256 * whole + (256 * rest + weight / 2) / weight) as u16)
}

/// Sums over one row of taxels, two neighbours at a time.
#[derive(Default)]
struct Row {
    /// Counts of all taxels, as a [`pair`].
    all: u32,
    /// Taxels touched, as a [`pair`].
    touched: u32,
    /// Σ count over the touched taxels.
    weight: u32,
    /// Σ count · column.
    col: u32,
    /// Σ count · column².
    col_col: u32,
}

impl Row {
    #[inline]
    fn new(pairs: &[[u16; 2]; TAXEL_COLS / 2]) -> Self {
        // A count has 12 bits; added to this it reaches bit 15 from TAXEL_TOUCH_MIN on.
        const REACH: u32 = pair([0x8000 - TAXEL_TOUCH_MIN; 2]);
        const BIT_15: u32 = pair([0x8000; 2]);
        let (mut all, mut reach) = (0, 0);
        for &two in pairs {
            all += pair(two);
            reach |= pair(two) + REACH;
        }
        if reach & BIT_15 == 0 {
            return Self { all, ..Self::default() };
        }
        let mut touched = 0;
        let kept = pairs.map(|two| {
            let two = pair(two);
            let reached = (two + REACH) & BIT_15;
            touched += reached >> 15;
            // 15 ones where bit 15 is set.
            two & (reached - (reached >> 15))
        });
        // From the last pair to the first, sums, sums of the sums, and sums of those weigh pair j by 1, j + 1 and
        // (j + 1)(j + 2)/2, without a product. `right` is the same for the right taxels alone.
        let (mut sum, mut sum2, mut sum3) = (0, 0, 0);
        let (mut right, mut right2) = (0, 0);
        for &kept in kept.iter().rev() {
            sum += sum_halves(kept);
            sum2 += sum;
            sum3 += sum2;
            right += kept >> 16;
            right2 += right;
        }
        // Σ j, Σ j² and, of the right ones, Σ j; a left taxel is in column 2j, a right one in 2j + 1.
        let j = sum2 - sum;
        let j_j = 2 * sum3 - 3 * j - 2 * sum;
        let right_j = right2 - right;
        Self { all, touched, weight: sum, col: 2 * j + right, col_col: 4 * (j_j + right_j) + right }
    }
}

/// Sums over the touched taxels, exact: 32 rows of 32 counts below 2^12, squares that add up to 10,416 in a row or
/// a column: all below 2^31.
#[derive(Default)]
struct Moments {
    weight: u32,
    row: u32,
    col: u32,
    row_row: u32,
    col_col: u32,
    row_col: u32,
}

impl Moments {
    fn add(&mut self, row: u32, cells: &Row) {
        self.weight += cells.weight;
        self.row += row * cells.weight;
        self.col += cells.col;
        self.row_row += row * row * cells.weight;
        self.col_col += cells.col_col;
        self.row_col += row * cells.col;
    }

    /// Angle of the larger principal axis and how much longer it is.
    fn axis(&self) -> (i8, Q<u8, 8>) {
        // weight² times the covariances, below 2^56: exact, then rounded once to single precision.
        let covariance =
            |square: u32, [a, b]: [u32; 2]| (self.weight as i64 * square as i64 - a as i64 * b as i64) as f32;
        let rows = covariance(self.row_row, [self.row; 2]) * (ROW_PITCH_MM * ROW_PITCH_MM);
        let cols = covariance(self.col_col, [self.col; 2]) * (COL_PITCH_MM * COL_PITCH_MM);
        let both = covariance(self.row_col, [self.row, self.col]) * (ROW_PITCH_MM * COL_PITCH_MM);
        let difference = cols - rows;
        let spread = root(difference * difference + 4.0 * both * both);
        let (long, short) = (rows + cols + spread, (rows + cols - spread).max(0.0));
        if long <= 0.0 || spread <= 0.0 {
            return Default::default();
        }
        // By name: newer compilers have methods of these names of their own, which give other bits.
        let angle = 0.5 * F32Ext::atan2(2.0 * both, difference);
        let degrees = F32Ext::round(angle.to_degrees()) as i32;
        let axis = if degrees >= 90 { degrees - 180 } else { degrees };
        let elongation = 256.0 * (1.0 - root(short / long));
        (axis.clamp(-90, 89) as i8, Q::from_bits(elongation.clamp(0.0, 255.0) as u8))
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
