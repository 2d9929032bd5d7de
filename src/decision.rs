//! From logits to the class of a frame, and to the flag.
//!
//! The *class* is the paper's: the pads decide contact, then the larger of the other two logits wins. The *flag* is for
//! acting on: the detector's log-odds of slip exceeded a threshold in enough of the last frames. Both numbers come from
//! the model file's [`OperatingPoint`], fixed on validation data for a rate of false alarms.

use crate::fixed::Logit;
use crate::net::format::OperatingPoint;
use crate::params::CLASSES;

/// The state of the grasp at one frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Class {
    /// No pad is touched.
    NoContact = 0,
    /// Held.
    NoSlip = 1,
    /// Slipping.
    Slip = 2,
}

impl Class {
    /// `touched`: whether a pad is touched; `None` if that is not known, then all three logits compete. A tie goes to
    /// the class before.
    pub fn new(touched: Option<bool>, [no_contact, no_slip, slip]: [Logit; CLASSES]) -> Self {
        let held = if slip > no_slip { Self::Slip } else { Self::NoSlip };
        match touched {
            Some(false) => Self::NoContact,
            Some(true) => held,
            None if no_contact >= no_slip.max(slip) => Self::NoContact,
            None => held,
        }
    }
}

/// The flag and its history: which of the last frames exceeded the threshold.
#[derive(Clone, Copy, Debug)]
pub struct Decision {
    point: OperatingPoint,
    /// Bit 0 is the newest frame.
    over: u32,
}

impl Decision {
    /// Before the first frame. `point` is one that [`OperatingPoint::check`] accepts, as every
    /// [`Model`](crate::net::Model)'s is.
    pub const fn new(point: OperatingPoint) -> Self {
        Self { point, over: 0 }
    }

    /// The operating point.
    pub const fn point(&self) -> OperatingPoint {
        self.point
    }

    /// Add the log-odds of the next frame, `None` where no pad is touched, which cannot slip: is the flag up?
    pub fn step(&mut self, log_odds: Option<Logit>) -> bool {
        let over = log_odds.is_some_and(|log_odds| log_odds > self.point.threshold);
        let dropped = u32::BITS.saturating_sub(self.point.n as u32).min(u32::BITS - 1);
        self.over = (self.over << 1 | over as u32) & u32::MAX >> dropped;
        self.over.count_ones() >= self.point.k as u32
    }
}
