//! From the ADC's code to the count on the wire, and back: the front end's reading is linear in conductance, a count
//! is not.
//!
//! A *code* is what the ADC gives, 0 to 65,535; without pressure it reads about [`IDLE_CODE`]. A *count* has 12 bits:
//! recordings, wire, pipeline and network know nothing else. Between them stands one law for every taxel,
//!
//! ```text
//! count = min(4095, round(ASYMPTOTE · c / (c + HALF_CODE)))       c: codes above idle, offset and gain corrected
//! ```
//!
//! which gives a light grip the fine steps and leaves 4095 to 5 MPa. It is that of the synthetic film, on which the
//! network was trained (`host-tools/synth/src/film/circuit.rs`). Nowhere does a code more make a count more than one
//! more, so every count has a code: [`code`].

use crate::params::COUNT_MAX;

/// Code of an untouched taxel, as the circuit is simulated (`cargo xtask front-end`): it lies above 0, so that no offset
/// is cut off.
pub const IDLE_CODE: u16 = 2_944;
/// Codes above idle at 5 MPa, full scale. Some 2,900 codes more and the amplifier ends.
pub const FULL_SCALE_CODES: u32 = 56_977;
/// Counts at infinite conductance; the film's 4,940.5 rounded, so that its count at 5 MPa is 4095.
pub const ASYMPTOTE: u32 = 4_941;
/// Codes above idle at which the count is half of [`ASYMPTOTE`].
pub const HALF_CODE: u32 = {
    let (most, above) = (COUNT_MAX as u32, ASYMPTOTE - COUNT_MAX as u32);
    (FULL_SCALE_CODES * above + most / 2) / most
};
/// Codes above idle that [`count`] takes: twice what an ADC of 16 bits gives.
pub const CODES_MAX: u32 = 2 * u16::MAX as u32;

/// The count of so many codes above idle, at most [`CODES_MAX`]. Rounded by the project's rule, floor(x + 1/2).
#[inline]
pub const fn count(codes: u32) -> u16 {
    let below = codes + HALF_CODE;
    // At most 2 · 4941 · 131,070 + 144,000: 31 bits.
    let rounded = (2 * ASYMPTOTE * codes + below) / (2 * below);
    if rounded < COUNT_MAX as u32 { rounded as u16 } else { COUNT_MAX }
}

/// The fewest codes above idle of which [`count`] makes this count, which has 12 bits.
pub const fn code(count: u16) -> u16 {
    if count == 0 {
        return 0;
    }
    // The least c with ASYMPTOTE · c / (c + HALF_CODE) ≥ count − 1/2.
    let twice = 2 * (if count < COUNT_MAX { count } else { COUNT_MAX }) as u32 - 1;
    (twice * HALF_CODE).div_ceil(2 * ASYMPTOTE - twice) as u16
}

/// A code at which an untrimmed taxel reads this count: what replays a recording through a scan.
pub const fn adc_code(count: u16) -> u16 {
    IDLE_CODE + code(count)
}

const _: () = assert!(2 * ASYMPTOTE as u64 * CODES_MAX as u64 + CODES_MAX as u64 + 65_535 <= u32::MAX as u64);
const _: () = assert!(IDLE_CODE as u32 + FULL_SCALE_CODES < u16::MAX as u32, "5 MPa is below the ADC's end");
