//! The half-band filter of the decimation by 2.
//!
//! Written by `tests/python/make_tables.py` with 60 decimal digits, every entry rounded as
//! `floor(x + 1/2)`; `make_tables.py --check` compares. Not to be edited by hand.

/// Coefficients at offsets 1, 3, 5, ... from the centre of the 47 taps, Q15: a sinc under a Kaiser
/// window for 60 dB. The centre is 1/2, the even offsets are 0.
pub static HALF_BAND_Q15: [i32; 12] = [10380, -3328, 1846, -1169, 772, -510, 330, -205, 120, -64, 29, -9];
