//! The raw frame compressed, without loss: `dsdl/slipsense/6202.RawCompressed.1.0.dsdl`.
//!
//! Every message can be decoded alone: one that is lost or damaged costs its own frame only. Where the bus cannot carry
//! everything ([`Detail`]), the taxels beside the contact are left out first, then all taxels.
//!
//! ```text
//! taxels ── predicted from their neighbours ───┐ difference, context
//! samples ── predicted from the ones before ───┴──> frequencies of the context ──> range coder ──> bytes
//! ```
//!
//! The frequencies (`tables.rs`) are fixed, from synthetic training episodes. Where coding would be longer than the
//! plain bits, the message has these, packed.
//!
//! # The coded bytes
//!
//! A number is coded with a table of 40 symbols, whose frequencies sum to 4096: 0 to 15 are a symbol each, then each
//! half octave has one, 16 to 23, 24 to 31, 32 to 47, and so on; the low bits that the symbol leaves open follow as
//! plain bits. Signed numbers are folded to 0, -1, 1, -2, 2. The range coder holds 32 bits, begins with the range
//! 2^32 - 1, and gives 16 bits out, low byte first, when the range is below 2^16; a symbol takes `range >> 12` times its
//! frequency, n plain bits `range >> n`. At the end it gives out the lower end of its interval, 32 bits, so that a decoder
//! takes every byte and no more.
//!
//! First, for each axis with at least one sample: 2 bits predictor p, 4 bits scale s, the first sample in 16 bits. If
//! s is 15, all others are the same. Else follows each sample's difference, modulo 2^16, to
//! `last + floor((p - 1) * step / 2)` (p 0 to 3 is -1, 0, 1, 2 halves). Its table is that of `size`, which begins as
//! 4 * 2^s and becomes `size - floor(size / 4) + folded difference`.
//! Then the taxels, row by row, each by its neighbours left, above left and above. If all are 0, the difference to 0
//! with the first table. Else the difference to `floor((3 * (left + above) - 2 * above left) / 4)`, or to 0 where that
//! is negative, with the table of `1 + |left - above| + floor((left + above) / 16)`. A neighbour beside pad or region
//! is 0. The table of a size is the number of half octaves (`value.rs`), or the last one.
//!
//! # Detected damage
//!
//! Any change of one byte, for certain: a CRC covers all bytes but its own and finds every change within 16 consecutive
//! bits, and a wrong length leaves the decoder with bytes too many or too few.

mod message;
pub mod range;
mod taxels;
mod tables;
mod value;
mod xl;

pub use message::{COMPRESSED_BYTES_MAX, COMPRESSED_FRAME_BYTES, COMPRESSED_PORT, Detail};
pub use range::Sink;
pub use tables::{TAXEL_CONTEXTS, TAXEL_TABLES, XL_CONTEXTS, XL_TABLES};
pub use value::{SYMBOLS, Table, split};

use super::region::Region;
use crate::sensor::{PiezoFrame, XlSample};

/// Show all of a frame to any [`Sink`]: for whoever counts the symbols, to learn the tables.
pub fn model(sink: &mut impl Sink, piezo: &PiezoFrame, xl: &[XlSample]) {
    xl::encode(sink, xl);
    taxels::encode(sink, &Region::ALL, piezo.counts(), |_, _| true);
}
