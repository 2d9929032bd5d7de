//! From a 32-bit accumulator back to an activation: scaled by [`scale_q32`](crate::fixed::scale_q32), then cut to
//! its range by one of these.
//!
//! The multiplier of the scaling is `s_in · s_w / s_out · 2^32`, 0 to 2^31−1: real ratios below one half, one
//! rounding (`smmulr`). The exporter refuses a layer whose ratio does not fit.

use crate::fixed::saturate_i16;

/// Largest magnitude of a query or key: 32 products of two of them still fit an `i32`.
pub const QUERY_KEY_MAX: i32 = 8_191;

/// Signed activation, saturated to `i16`.
#[inline]
pub fn signed(scaled: i32) -> i16 {
    saturate_i16(scaled)
}

/// Activation after ReLU, 0 to 32767.
#[inline]
pub fn relu(scaled: i32) -> i16 {
    scaled.clamp(0, i16::MAX as i32) as i16
}

/// Query or key, ±[`QUERY_KEY_MAX`].
#[inline]
pub fn query_key(scaled: i32) -> i16 {
    scaled.clamp(-QUERY_KEY_MAX, QUERY_KEY_MAX) as i16
}
