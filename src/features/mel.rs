//! Step 5: 16 triangles on the HTK mel scale, 20 to 4000 Hz, height 1 (librosa's `htk=True, norm=None`).
//!
//! Between two neighbouring edges of the grid one triangle rises, the one below falls, and their weights add to 1: each
//! bin is multiplied once, for the rising one, and the rest goes to the falling one.

use super::tables::{MEL_RISING_Q24, MEL_SEGMENT_BINS};
use crate::params::{FFT_BINS, MEL_BINS};

const WEIGHT_FRAC_BITS: u32 = 24;

/// Power under each triangle in LSB², Q16, from bins in 3/4 LSB², Q16: each half of a triangle is rounded once, and
/// the 3/4 of their sum once.
///
/// Input: bins 1 to 63 sum to below 2^62.3. Then the low halves times weights sum to below
/// 63 · 2^32 · 2^24 < 2^62, the high ones to below 2^62.3 · 2^-32 · 2^24 < 2^55.
pub fn mel_power(power: &[u64; FFT_BINS]) -> [u64; MEL_BINS] {
    let mut mel = [0; MEL_BINS];
    // Bin 0 lies below the first edge, bin 64 on the last, where the weight is 0.
    let (mut powers, mut weights) = (&power[1..], &MEL_RISING_Q24[..]);
    let mut segments = MEL_SEGMENT_BINS.iter().map(|&count| {
        let (here, later) = powers.split_at_checked(count as usize).unwrap_or((powers, &[]));
        let (rising, weights_later) = weights.split_at_checked(count as usize).unwrap_or((weights, &[]));
        (powers, weights) = (later, weights_later);
        let (mut all, mut high, mut low) = (0u64, 0u64, 0u64);
        for (&power, &weight) in here.iter().zip(rising) {
            all += power;
            high += (power >> 32) * weight as u64;
            low += (power & 0xffff_ffff) * weight as u64;
        }
        // The remainder of the high half is none: 2^32 · high / 2^24 is a whole number.
        let rising =
            (high << (32 - WEIGHT_FRAC_BITS)) + ((low + (1 << (WEIGHT_FRAC_BITS - 1))) >> WEIGHT_FRAC_BITS);
        // Every weight is at most 1, so rising ≤ all, rounded or not.
        Segment { rising, falling: all - rising }
    });
    let mut below = segments.next().unwrap_or_default();
    for (mel, segment) in mel.iter_mut().zip(segments) {
        let sum = below.rising + segment.falling;
        // Less a quarter, whose ties round down where the rest rounds up.
        *mel = sum - ((sum + 1) >> 2);
        below = segment;
    }
    mel
}

#[derive(Default)]
struct Segment {
    rising: u64,
    falling: u64,
}
