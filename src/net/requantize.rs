//! From a 32-bit accumulator back to an activation.
//!
//! `multiplier` is `s_in · s_w / s_out · 2^32`, 0 to 2^31−1: real ratios below one half, one rounding
//! (`smmulr`). The exporter refuses a layer whose ratio does not fit.

use crate::fixed::{saturate_i16, scale_q32};

/// Largest magnitude of a query or key: 32 products of two of them still fit an `i32`.
pub const QUERY_KEY_MAX: i32 = 8_191;

/// Signed activation, saturated to `i16`.
#[inline]
pub const fn signed(acc: i32, multiplier: i32) -> i16 {
    saturate_i16(scale_q32(acc, multiplier))
}

/// Activation after ReLU, 0 to 32767.
#[inline]
pub const fn relu(acc: i32, multiplier: i32) -> i16 {
    let x = signed(acc, multiplier);
    if x < 0 { 0 } else { x }
}

/// Query or key, ±[`QUERY_KEY_MAX`].
#[inline]
pub const fn query_key(acc: i32, multiplier: i32) -> i16 {
    let x = scale_q32(acc, multiplier);
    if x > QUERY_KEY_MAX {
        QUERY_KEY_MAX as i16
    } else if x < -QUERY_KEY_MAX {
        -QUERY_KEY_MAX as i16
    } else {
        x as i16
    }
}
