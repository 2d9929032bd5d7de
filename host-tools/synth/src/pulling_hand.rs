//! A hand that pulls or twists no harder than it can: with its spring stretched that far, the far end stays.

use crate::friction::Pull;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PullLimit {
    pub pull_n: f64,
    pub twist_n_mm: f64,
}

impl PullLimit {
    /// The part of it that one finger's contact bears.
    pub(crate) fn shared(self, share: f64) -> Self {
        Self { pull_n: self.pull_n * share, twist_n_mm: self.twist_n_mm * share }
    }
}

/// Far ends of the springs, x and y in mm and turn in rad.
#[derive(Default)]
pub(crate) struct PullingHand {
    /// Where a hand of any strength would be.
    planned: [f64; 3],
    at: [f64; 3],
}

impl PullingHand {
    /// Go the way from the last step's plan to this one, where strength allows. `object` is position and turn.
    pub(crate) fn pull(&mut self, plan: Pull, strength: PullLimit, object: ([f64; 2], f64)) -> Pull {
        let planned = [plan.position_mm[0], plan.position_mm[1], plan.turn_rad];
        let on: [f64; 3] = std::array::from_fn(|axis| self.at[axis] + planned[axis] - self.planned[axis]);
        self.planned = planned;
        let stretch = |at: [f64; 3]| {
            let [x, y] = [at[0] - object.0[0], at[1] - object.0[1]];
            (x * x + y * y).sqrt()
        };
        let twist = |at: [f64; 3]| (at[2] - object.1).abs();
        // What lets the spring go slack is within anyone's strength.
        if stretch(on) * plan.stiffness_n_per_mm <= strength.pull_n || stretch(on) < stretch(self.at) {
            [self.at[0], self.at[1]] = [on[0], on[1]];
        }
        if twist(on) * plan.twist_n_mm_per_rad <= strength.twist_n_mm || twist(on) < twist(self.at) {
            self.at[2] = on[2];
        }
        Pull { position_mm: [self.at[0], self.at[1]], turn_rad: self.at[2], ..plan }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STRENGTH: PullLimit = PullLimit { pull_n: 2.0, twist_n_mm: 10.0 };

    fn to(mm: f64, rad: f64) -> Pull {
        Pull { position_mm: [0.0, mm], turn_rad: rad, stiffness_n_per_mm: 4.0, twist_n_mm_per_rad: 100.0 }
    }

    #[test]
    fn it_stops_at_its_strength_and_goes_on_when_the_object_gives_way() {
        let mut hand = PullingHand::default();
        for step in 1..=100 {
            let pull =
                hand.pull(to(0.05 * f64::from(step), 0.01 * f64::from(step)), STRENGTH, ([0.0; 2], 0.0));
            assert!(pull.position_mm[1] * 4.0 <= 2.0 + 1e-9 && pull.turn_rad * 100.0 <= 10.0 + 1e-9);
        }
        let held = hand.pull(to(5.0, 1.0), STRENGTH, ([0.0; 2], 0.0));
        assert!((held.position_mm[1] - 0.5).abs() < 1e-9 && (held.turn_rad - 0.1).abs() < 1e-9);
        // It does not catch up: it moves at its own speed from where it stopped.
        let slid = hand.pull(to(5.05, 1.01), STRENGTH, ([0.0, 0.3], 0.2));
        assert!((slid.position_mm[1] - 0.55).abs() < 1e-9 && (slid.turn_rad - 0.11).abs() < 1e-9);
    }

    #[test]
    fn it_can_always_let_go() {
        let mut hand = PullingHand::default();
        hand.pull(to(0.4, 0.0), STRENGTH, ([0.0; 2], 0.0));
        // The object has been taken the other way: the pull is beyond any strength.
        let back = hand.pull(to(0.3, 0.0), STRENGTH, ([0.0, -2.0], 0.0));
        assert!((back.position_mm[1] - 0.3).abs() < 1e-9);
    }
}
