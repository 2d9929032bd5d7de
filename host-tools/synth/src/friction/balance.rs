//! The move of the object for which springs and brushes balance.
//!
//! A brush that is stretched to a trial force t holds t while |t| is within its cap and slides along t
//! beyond it: the gradient of `|t|²/2k`, which goes on as the straight `cap·|t|/k − cap²/2k` (Huber's
//! function). With the springs' energy the sum is convex and smooth, so the balance is its one minimum.
//! Newton's method finds it; a step that does not lower the energy enough is halved.

use super::Springs;

#[derive(Clone, Copy)]
pub(super) struct Brush {
    /// Force it holds before the move.
    held_n: [f64; 2],
    /// Force it can hold.
    cap_n: f64,
    /// Place, from the point the object turns about.
    pub arm_mm: [f64; 2],
    /// Force it would hold after the move that was looked at last, if it could hold any.
    trial_n: [f64; 2],
    /// Size of that force if the brush slides, else 0.
    sliding_n: f64,
}

impl Brush {
    pub fn new(held_n: [f64; 2], cap_n: f64, arm_mm: [f64; 2]) -> Self {
        Self { held_n, cap_n, arm_mm, trial_n: held_n, sliding_n: 0.0 }
    }

    /// After the move: the force held, the part of the trial force that slid off, and its size.
    pub fn after(&self) -> ([f64; 2], [f64; 2], f64) {
        let t = self.trial_n;
        if self.sliding_n == 0.0 {
            return (t, [0.0; 2], 0.0);
        }
        let share = self.cap_n / self.sliding_n;
        let held = t.map(|n| share * n);
        (held, [t[0] - held[0], t[1] - held[1]], self.sliding_n - self.cap_n)
    }
}

/// Energy at a move, with its gradient and second derivatives (upper triangle: xx, xy, yy, xt, yt, tt).
#[derive(Clone, Copy)]
struct Slope {
    energy: f64,
    force: [f64; 3],
    stiffness: [f64; 6],
}

/// Length over which a turn is compared with a shift, mm: about the half width of a patch.
const ARM_MM: f64 = 3.0;
/// Balance is reached within this share of the largest force that could act.
const EXACT: f64 = 1e-5;

/// Move `[x, y, turn]` in mm and rad at which everything balances, and leave the brushes as they are after it;
/// `guess` is where the search starts. `k` is the stiffness of one brush, N/mm.
pub(super) fn solve(brushes: &mut [Brush], k: f64, springs: &Springs, guess: [f64; 3]) -> [f64; 3] {
    let [pulls, _, turns] = springs.stiffness.map(|stiffness| stiffness > 0.0);
    let free = |v: [f64; 3]| {
        let (shift, turn) = (f64::from(u8::from(pulls)), f64::from(u8::from(turns)));
        [v[0] * shift, v[1] * shift, v[2] * turn]
    };
    if brushes.is_empty() {
        return free(springs.stretch);
    }
    let held: f64 = brushes.iter().map(|b| b.cap_n).sum();
    let exact = EXACT * held.max(1e-6);
    let mut evaluate = |at| {
        if turns { slope::<true>(brushes, k, springs, at) } else { slope::<false>(brushes, k, springs, at) }
    };
    let mut at = free(guess);
    let mut here = evaluate(at);
    if !pulls && !turns {
        return at;
    }
    for _ in 0..60 {
        let force = free(here.force);
        if force[0].abs() < exact && force[1].abs() < exact && force[2].abs() < exact * ARM_MM {
            break;
        }
        let step = newton(force, here.stiffness, pulls, turns);
        let fall = force[0] * step[0] + force[1] * step[1] + force[2] * step[2];
        let mut share = 1.0;
        let next = loop {
            let try_at = [at[0] + share * step[0], at[1] + share * step[1], at[2] + share * step[2]];
            let there = evaluate(try_at);
            // The last digits of a sum of energies say nothing about a fall smaller than they are.
            let noise = 1e-14 * (here.energy.abs() + 1e-3);
            if there.energy <= here.energy + 1e-4 * share * fall + noise || share < 1e-6 {
                break (try_at, there);
            }
            share *= 0.5;
        };
        (at, here) = next;
    }
    at
}

/// Energy and derivatives; `TURN` is whether the object may turn.
fn slope<const TURN: bool>(brushes: &mut [Brush], k: f64, springs: &Springs, at: [f64; 3]) -> Slope {
    let [kp, _, kt] = springs.stiffness;
    let left: [f64; 3] = std::array::from_fn(|i| at[i] - springs.stretch[i]);
    let mut energy = 0.5 * kp * (left[0] * left[0] + left[1] * left[1]) + 0.5 * kt * left[2] * left[2];
    let mut force = [kp * left[0], kp * left[1], kt * left[2]];
    let mut h = [kp, 0.0, kp, 0.0, 0.0, kt];
    let soft = 1.0 / k;
    for brush in brushes {
        let ([x, y], cap) = (brush.arm_mm, brush.cap_n);
        let stretch = if TURN { [at[0] - at[2] * y, at[1] + at[2] * x] } else { [at[0], at[1]] };
        let t = [brush.held_n[0] + k * stretch[0], brush.held_n[1] + k * stretch[1]];
        brush.trial_n = t;
        let size2 = t[0] * t[0] + t[1] * t[1];
        // Stiffness of this brush: k in full while it sticks, across its slip only while it slides.
        let (f, xx, xy, yy);
        if size2 <= cap * cap {
            brush.sliding_n = 0.0;
            energy += 0.5 * soft * size2;
            (f, xx, xy, yy) = (t, k, 0.0, k);
        } else {
            let size = size2.sqrt();
            brush.sliding_n = size;
            let inverse = 1.0 / size;
            let share = cap * inverse;
            energy += soft * cap * (size - 0.5 * cap);
            let (n, left) = ([t[0] * inverse, t[1] * inverse], k * share);
            f = [share * t[0], share * t[1]];
            (xx, xy, yy) = (left * n[1] * n[1], -left * n[0] * n[1], left * n[0] * n[0]);
        }
        force[0] += f[0];
        force[1] += f[1];
        h[0] += xx;
        h[1] += xy;
        h[2] += yy;
        if TURN {
            force[2] += x * f[1] - y * f[0];
            h[3] += x * xy - y * xx;
            h[4] += x * yy - y * xy;
            h[5] += y * y * xx - 2.0 * x * y * xy + x * x * yy;
        }
    }
    Slope { energy, force, stiffness: h }
}

/// Newton's step: minus the inverse of the stiffness times the force, over what is free.
fn newton(force: [f64; 3], h: [f64; 6], pulls: bool, turns: bool) -> [f64; 3] {
    let [xx, xy, yy, xt, yt, tt] = h;
    if !pulls {
        return [0.0, 0.0, -force[2] / tt];
    }
    // Of the shift, with the turn held.
    let det = xx * yy - xy * xy;
    let shift = |f: [f64; 2]| [(yy * f[0] - xy * f[1]) / det, (xx * f[1] - xy * f[0]) / det];
    let alone = shift([force[0], force[1]]);
    if !turns {
        return [-alone[0], -alone[1], 0.0];
    }
    // Eliminate the shift from the turn's equation.
    let with_turn = shift([xt, yt]);
    let stiffness = tt - xt * with_turn[0] - yt * with_turn[1];
    let turn = -(force[2] - xt * alone[0] - yt * alone[1]) / stiffness;
    [-alone[0] - with_turn[0] * turn, -alone[1] - with_turn[1] * turn, turn]
}
