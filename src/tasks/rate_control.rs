//! How much of each compressed raw message goes when the bus is behind.
//!
//! What goes first is declared: the slip message, then every sensor's accelerometer, then the taxels of the contacts,
//! then the rest. Nobody tells a node how much of the bus is free; the raw messages that still wait when the next ones
//! are made do. While none waits, each frame gives one sensor more a step of detail, the sensors in turn. When they
//! pile up there is none for a moment, and after that half as much at most; every 240 frames that go well allow
//! one step more. A step too many can fill the queue before it shows: the message that then finds no room is dropped
//! whole, and counted.

use crate::params::{FRAME_RATE_HZ, MAX_SENSORS};
use crate::wire::Detail;

/// Steps of detail that the sensors share: with none all send the accelerometer alone, with one for each all add the
/// contact, with two for each everything.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RateControl {
    now: usize,
    /// As many as have gone well lately.
    allowed: usize,
    /// Frames in a row that found nothing waiting.
    calm_frames: u32,
}

impl RateControl {
    /// Everything.
    pub(super) const ALL: Self = Self { now: 2 * MAX_SENSORS, allowed: 2 * MAX_SENSORS, calm_frames: 0 };

    /// A frame is to be sent while `waiting` raw messages wait.
    pub(super) fn frame(&mut self, waiting: usize, sensors: usize) {
        match waiting {
            0 => {
                self.calm_frames += 1;
                if self.calm_frames >= FRAME_RATE_HZ {
                    self.calm_frames = 0;
                    self.allowed += 1;
                }
                self.now += 1;
            }
            // It may be on its way.
            1 => {}
            _ => {
                if self.now > 0 {
                    self.allowed = self.now / 2;
                }
                self.now = 0;
                self.calm_frames = 0;
            }
        }
        self.allowed = self.allowed.min(2 * sensors);
        self.now = self.now.min(self.allowed);
    }

    /// What the sensor whose turn is the `turn`-th in this frame sends.
    pub(super) const fn detail(self, turn: usize, sensors: usize) -> Detail {
        if self.now > sensors + turn {
            Detail::All
        } else if self.now > turn {
            Detail::Contact
        } else {
            Detail::Accelerometer
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn details(rate: RateControl) -> [Detail; 3] {
        core::array::from_fn(|turn| rate.detail(turn, 3))
    }

    #[test]
    fn a_bus_that_keeps_up_gets_everything() {
        for sensors in 1..=MAX_SENSORS {
            let mut rate = RateControl::ALL;
            for waiting in [0, 1, 0, 1] {
                rate.frame(waiting, sensors);
                assert!((0..sensors).all(|turn| rate.detail(turn, sensors) == Detail::All));
            }
            assert_eq!((rate.now, rate.allowed), (2 * sensors, 2 * sensors), "no more than there are steps");
        }
    }

    #[test]
    fn detail_comes_back_one_sensor_at_a_time_and_contacts_first() {
        use Detail::{Accelerometer, All, Contact};
        let mut rate = RateControl::ALL;
        rate.frame(4, 3);
        assert_eq!(details(rate), [Accelerometer; 3]);
        // While they drain, nothing more is taken away.
        rate.frame(5, 3);
        rate.frame(1, 3);
        assert_eq!(details(rate), [Accelerometer; 3]);
        let mut after = |frames: u32| {
            (0..frames).for_each(|_| rate.frame(0, 3));
            details(rate)
        };
        assert_eq!(after(1), [Contact, Accelerometer, Accelerometer]);
        assert_eq!(after(1), [Contact, Contact, Accelerometer]);
        assert_eq!(after(1), [Contact; 3], "half of what was too much, at once");
        assert_eq!(after(FRAME_RATE_HZ - 4), [Contact; 3]);
        assert_eq!(after(1), [All, Contact, Contact], "then one step a second");
        assert_eq!(after(FRAME_RATE_HZ), [All, All, Contact]);
        assert_eq!(after(FRAME_RATE_HZ), [All; 3]);
        assert_eq!(after(2 * FRAME_RATE_HZ), [All; 3]);
        assert_eq!(rate, RateControl { calm_frames: 0, ..RateControl::ALL });
    }
}
