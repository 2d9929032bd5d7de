//! The re-grasp controller: while the flag is up, the fingers move inward, one motion after the other.

use slipsense::wire::SlipMessage;
use slipsense_synth::plant::GRIP_MAX_N;

/// Which flag of the slip message is acted on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Flag {
    /// `may_begin`, the class of the frame: what the paper's controller acts on.
    MayBegin,
    /// `slip`, the flag to act on.
    Slip,
}

impl Flag {
    pub const fn is_up(self, message: &SlipMessage) -> bool {
        message.invalid == 0
            && match self {
                Self::MayBegin => message.may_begin,
                Self::Slip => message.slip,
            }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Reaction {
    pub flag: Flag,
    /// A motion multiplies the grip by this.
    pub gain: f64,
    /// After a motion the flag is ignored for this long, milliseconds: joints and skin are still in motion.
    pub settle_ms: f64,
}

impl Reaction {
    /// Chosen with `--objects val --seed 7 --trials 12`, never on what is reported: of 1.6 and 20 ms, 1.6 and 60 ms
    /// (8 and 12 trials), 2 and 100 ms all kept every object, and the last took the fewest motions. A shorter wait
    /// answers the sound of the motion itself.
    pub const GAIN: f64 = 2.0;
    pub const SETTLE_MS: f64 = 100.0;
}

/// A controller in a grasp. It knows the messages from the bus and its own commands, nothing else.
#[derive(Clone, Debug)]
pub struct Controller {
    reaction: Reaction,
    target_n: f64,
    /// Flags before are ignored.
    ignore_until_ns: u64,
}

impl Controller {
    /// Of a gripper that holds with `grip_n` per finger.
    pub const fn new(reaction: Reaction, grip_n: f64) -> Self {
        Self { reaction, target_n: grip_n, ignore_until_ns: 0 }
    }

    /// A message has arrived: the grip to command, if any, newtons; it is reached `actuator_ns` later.
    pub fn receive(&mut self, message: &SlipMessage, now_ns: u64, actuator_ns: u64) -> Option<f64> {
        if !self.reaction.flag.is_up(message) || now_ns < self.ignore_until_ns || self.target_n >= GRIP_MAX_N
        {
            return None;
        }
        self.target_n = (self.target_n * self.reaction.gain).min(GRIP_MAX_N);
        self.ignore_until_ns = now_ns + actuator_ns + (self.reaction.settle_ms * 1e6) as u64;
        Some(self.target_n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(may_begin: bool, slip: bool) -> SlipMessage {
        SlipMessage { may_begin, slip, ..SlipMessage::default() }
    }

    #[test]
    fn it_moves_once_per_motion_and_ends_at_the_grippers_force() {
        let reaction = Reaction { flag: Flag::MayBegin, gain: 2.0, settle_ms: 20.0 };
        let mut controller = Controller::new(reaction, 2.0);
        let mut commands = Vec::new();
        for ms in 0..400u64 {
            let now_ns = ms * 1_000_000;
            commands.extend(controller.receive(&message(true, false), now_ns, 30_000_000).map(|n| (ms, n)));
        }
        assert_eq!(commands, [(0, 4.0), (50, 8.0), (100, 12.0)]);
    }

    #[test]
    fn it_acts_on_the_configured_flag() {
        let reaction = Reaction { flag: Flag::Slip, gain: 2.0, settle_ms: 0.0 };
        let mut controller = Controller::new(reaction, 2.0);
        assert_eq!(controller.receive(&message(true, false), 0, 0), None);
        assert_eq!(controller.receive(&message(false, true), 1, 0), Some(4.0));
        assert_eq!(controller.receive(&message(false, false), 2, 0), None);
    }
}
