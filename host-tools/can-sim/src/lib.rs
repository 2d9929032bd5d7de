//! What a CAN FD bus does with a frame, bit by bit: how long the frame is with its stuff bits, how long it takes
//! with a switch of the bit rate, who wins arbitration, what an error costs, when a node goes silent and when it
//! comes back.
//!
//! ```text
//! Frame ──> wire_bits ──> FrameBits ──> Timing::frame ──> Bus: arbitration, acknowledge, errors, bus-off
//!           every bit     how many     clock cycles
//! ```
//!
//! Emulated peripheral, scheduler tests and bus planner use the same arithmetic. [`controller`] has a bus of its own, on
//! which a frame of a length always takes that length's worst case. Times are whole cycles of the CAN kernel clock, so
//! nothing is rounded until someone asks for nanoseconds.
//!
//! The rules are ISO 11898-1:2015's, cited by the names of its fields and written from memory of the standard and
//! of Bosch's CAN FD specification 1.0; an encoder in Python that shares no code with this one and gives the published
//! check values of the three CRCs is the oracle of every bit (`tests/python/check_can_bits.py`).
#![forbid(unsafe_code)]

mod bus;
pub mod busload;
mod confinement;
pub mod controller;
mod crc;
mod frame;
mod timing;
mod wire_bits;
mod worst_case;

pub use bus::{Attempt, Bus, Collision, Disturbance, Outcome};
pub use confinement::{ErrorState, FaultConfinement, RECOVERY_BITS};
pub use frame::{Format, Frame, FrameError, Id, MAX_DATA, dlc_of, len_of};
pub use timing::{BitTiming, INTERMISSION, Timing, TimingError};
pub use wire_bits::{Field, FrameBits, Rate, WireBit, wire_bits};
pub use worst_case::worst_case;
