//! What a CAN FD bus does with a frame, bit by bit: how long the frame is with its stuff bits, how long it takes
//! with a switch of the bit rate, who wins arbitration, what an error costs, when a node goes silent and when it
//! comes back.
//!
//! ```text
//! Frame ──> wire_bits ──> FrameBits ──> Timing::frame ──> Bus: arbitration, acknowledge, errors, bus-off
//!           every bit     how many     clock cycles
//! ```
//!
//! The emulated peripheral, the scheduler's tests and the bus planner use the same arithmetic. [`controller`] has a bus of
//! its own, on which each frame takes the longest time that a frame of its length can take. Times are whole cycles of the
//! CAN kernel clock: nothing is rounded until someone asks for nanoseconds.
//!
//! The rules are those of ISO 11898-1:2015, with its names of the fields. They were written from memory of that standard
//! and of Bosch's CAN FD specification 1.0. A Python encoder that shares no code with this one checks every bit; it gives
//! the published check values of the three CRCs (`tests/python/check_can_bits.py`).
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
