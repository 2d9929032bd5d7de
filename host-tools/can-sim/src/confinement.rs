//! Fault confinement: error counters, error passive, bus-off and the way back (ISO 11898-1:2015, fault
//! confinement).

/// The shortest way back from bus-off, in nominal bits: 128 times 11 recessive bits.
pub const RECOVERY_BITS: u64 = 128 * 11;

/// Both counters at most this: error active.
const ACTIVE_MAX: u16 = 127;
/// The transmit counter above this: off.
const OFF_ABOVE: u16 = 255;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorState {
    /// Takes part; its error flag is dominant and stops everybody.
    Active,
    /// Takes part; its error flag is recessive, and it waits 8 bits longer after it sent.
    Passive,
    /// Silent until the bus was quiet for [`RECOVERY_BITS`] and its software asked for it.
    BusOff,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultConfinement {
    tec: u16,
    rec: u16,
}

impl FaultConfinement {
    pub const fn new() -> Self {
        Self { tec: 0, rec: 0 }
    }

    /// Transmit error counter; above 255 the node is off.
    pub const fn transmit_errors(&self) -> u16 {
        self.tec
    }

    pub const fn receive_errors(&self) -> u16 {
        self.rec
    }

    pub const fn state(&self) -> ErrorState {
        if self.tec > OFF_ABOVE {
            ErrorState::BusOff
        } else if self.tec > ACTIVE_MAX || self.rec > ACTIVE_MAX {
            ErrorState::Passive
        } else {
            ErrorState::Active
        }
    }

    /// A counter has reached 96 (the limit at which controllers warn).
    pub const fn warns(&self) -> bool {
        self.tec >= 96 || self.rec >= 96
    }

    /// Rule: after a successful transmission the transmit counter falls by 1.
    pub const fn transmitted(&mut self) {
        self.tec = self.tec.saturating_sub(1);
    }

    /// Rule: after a successful reception the receive counter falls by 1; from above 127 to a value of 119 to 127,
    /// here 127 as Bosch's controllers do.
    pub const fn received(&mut self) {
        self.rec = if self.rec > ACTIVE_MAX { ACTIVE_MAX } else { self.rec.saturating_sub(1) };
    }

    /// Rule: a transmitter that sends an error flag counts 8. At more than 255 it is off.
    pub const fn transmit_error(&mut self) {
        self.tec += 8;
    }

    /// Nobody acknowledged. Exception to the rule above: an error-passive transmitter that sees no dominant bit
    /// while it sends its passive error flag does not count, so a node alone on the bus stays passive and never
    /// goes off.
    pub const fn not_acknowledged(&mut self) {
        if !matches!(self.state(), ErrorState::Passive) {
            self.transmit_error();
        }
    }

    /// Rule: a receiver that detects an error counts 1; the 8 more of the first to see it are not modelled, as all see
    /// it in the same bit. Stops counting at passive, as an 8 bit counter of a controller does at 128.
    pub const fn receive_error(&mut self) {
        if self.rec <= ACTIVE_MAX {
            self.rec += 1;
        }
    }

    /// Back on the bus after recovery: both counters at 0.
    pub const fn recovered(&mut self) {
        *self = Self::new();
    }
}
