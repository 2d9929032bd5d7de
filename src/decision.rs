//! From logits to what is said: the class of a frame, and the alarm.
//!
//! The *class* is the paper's: contact is what the pads say, between the rest the larger logit wins. The
//! *alarm* is for acting on. It compares the lead of slip's logit with a threshold and asks that enough of
//! the last frames agree; both come from the model file's [`OperatingPoint`], which was fixed on validation
//! data for a rate of false alarms. At [`OperatingPoint::ARGMAX`] the alarm is up exactly where the class
//! is slip.

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
    /// Contact is what the pads say; between the rest the larger logit wins, a tie goes to the class
    /// without slip. Where the pads leave contact open (`None`), all three logits compete.
    pub fn of(touched: Option<bool>, [no_contact, no_slip, slip]: [i32; CLASSES]) -> Self {
        let held = if slip > no_slip { Self::Slip } else { Self::NoSlip };
        match touched {
            Some(false) => Self::NoContact,
            Some(true) => held,
            None if no_contact >= no_slip.max(slip) => Self::NoContact,
            None => held,
        }
    }
}

/// How far slip's logit leads the largest of those that compete with it, 1/1024 nat: contact without slip,
/// and no contact where the pads leave contact open. `None` where no pad is touched: that cannot slip.
pub fn margin_q10(touched: Option<bool>, [no_contact, no_slip, slip]: [i32; CLASSES]) -> Option<i32> {
    match touched {
        Some(false) => None,
        Some(true) => Some(slip.saturating_sub(no_slip)),
        None => Some(slip.saturating_sub(no_slip.max(no_contact))),
    }
}

/// The alarm and what it remembers: which of the last frames were over the threshold.
#[derive(Clone, Copy, Debug)]
pub struct Decision {
    point: OperatingPoint,
    /// Bit 0 is the newest frame.
    over: u32,
}

impl Decision {
    /// Before the first frame: none was over. `point` is one that [`OperatingPoint::check`] accepts, as
    /// every [`Model`](crate::net::Model)'s is.
    pub const fn new(point: OperatingPoint) -> Self {
        Self { point, over: 0 }
    }

    /// Where it works.
    pub const fn point(&self) -> OperatingPoint {
        self.point
    }

    /// Take the margin of the next frame in: is the alarm up?
    pub fn step(&mut self, margin_q10: Option<i32>) -> bool {
        let over = margin_q10.is_some_and(|margin| margin > self.point.threshold_q10);
        let forgotten = u32::BITS.saturating_sub(self.point.n as u32).min(u32::BITS - 1);
        self.over = (self.over << 1 | over as u32) & u32::MAX >> forgotten;
        self.over.count_ones() >= self.point.k as u32
    }
}
