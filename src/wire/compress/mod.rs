//! The raw frame compressed, without loss: `dsdl/slipsense/6202.RawCompressed.1.0.dsdl`.
//!
//! Every message can be decoded alone, so one that is lost or damaged costs its own frame and nothing else. What
//! stands in it, in this order, is also what is given up last where the bus cannot carry everything ([`Detail`]):
//! accelerometer, contact, the other taxels. The slip message goes ahead of all by its priority.
//!
//! ```text
//! taxels ── predicted from their neighbours ───┐ difference, context
//! samples ── predicted from the ones before ───┴──> frequencies of the context ──> range coder ──> bytes
//! ```
//!
//! The frequencies are fixed (`tables.rs`): learnt once, from synthetic training episodes. Data that they do not suit
//! become longer, up to the point where packing the plain bits is shorter; then the message says so and does that.
//!
//! # The coded bytes
//!
//! A number is coded with a table of 40 symbols, whose frequencies sum to 4096: 0 to 15 are a symbol each, then each
//! half octave has one, 16 to 23, 24 to 31, 32 to 47, and so on; the low bits that the symbol leaves open follow as
//! plain bits. Signed numbers are folded to 0, -1, 1, -2, 2. The range coder holds 32 bits and gives a byte out when
//! the range is below 2^24; a symbol takes `range >> 12` times its frequency, n plain bits `range >> n`.
//!
//! First, for each axis with at least one sample: 2 bits predictor p, 4 bits scale s, the first sample in 16 bits;
//! then each sample's difference, modulo 2^16, to `last + floor((p - 1) * step / 2)` (p 0 to 3 is -1, 0, 1, 2 halves).
//! Its table is that of `size`, which begins as 4 * 2^s and becomes `size - floor(size / 4) + folded difference`.
//! Then the taxels, row by row: the difference to the median of left, above, and left + above - (above left); the
//! table is that of |left - above left| + |above - above left| + |above right - above| + floor(sum of the four / 32).
//! A neighbour beside pad or region is 0. The table of a size is the number of half octaves (`value.rs`),
//! or the last one.

mod message;
pub mod range;
mod region;
mod taxels;
mod tables;
mod value;
mod xl;

pub use message::{COMPRESSED_BYTES_MAX, Detail};
pub(super) use message::{decode, encode};
pub use range::Coder;
pub use region::Region;
pub use tables::{TAXEL_CONTEXTS, TAXEL_TABLES, Table, XL_CONTEXTS, XL_TABLES};
pub use value::{SYMBOLS, split};

use crate::sensor::{PiezoFrame, XlSample};

/// Code all of a frame with any [`Coder`]: for whoever counts the symbols, to learn the tables.
pub fn model(coder: &mut impl Coder, piezo: &PiezoFrame, xl: &mut [XlSample]) {
    xl::code(coder, xl);
    taxels::code(coder, &Region::ALL, &mut piezo.counts().clone(), |_, _| true);
}
