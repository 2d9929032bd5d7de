//! The move of the object for which springs and brushes balance.
//!
//! A brush that is stretched to a trial force t holds t while |t| is within its cap and slides along t
//! beyond it: the gradient of `|t|²/2k`, which goes on as the straight `cap·|t|/k − cap²/2k` (Huber's
//! function). With the springs' energy the sum is convex and smooth, so the balance is its one minimum.
//! Newton's method finds it; a step that does not lower the energy enough is halved.

/// One loaded cell.
#[derive(Clone, Copy)]
pub(super) struct Brush {
    /// Force it holds before the move.
    pub held_n: [f64; 2],
    /// Force it can hold.
    pub cap_n: f64,
    /// Place, from the point the object turns about.
    pub arm_mm: [f64; 2],
}

impl Brush {
    /// Force held after a `moved` of `[x, y, turn]`, and the part of the trial force that slid off.
    pub fn carried(&self, k: f64, moved: [f64; 3]) -> ([f64; 2], [f64; 2]) {
        let t = self.trial(k, moved);
        let size2 = t[0] * t[0] + t[1] * t[1];
        if size2 <= self.cap_n * self.cap_n {
            return (t, [0.0; 2]);
        }
        let share = self.cap_n / size2.sqrt();
        (t.map(|n| share * n), t.map(|n| (1.0 - share) * n))
    }

    fn trial(&self, k: f64, [x, y, turn]: [f64; 3]) -> [f64; 2] {
        [self.held_n[0] + k * (x - turn * self.arm_mm[1]), self.held_n[1] + k * (y + turn * self.arm_mm[0])]
    }
}

/// Springs on the object.
#[derive(Clone, Copy)]
pub(super) struct Springs {
    /// Far ends, from where the object is: x and y in mm, turn in rad.
    pub stretch: [f64; 3],
    /// Stiffness in x and y; 0 keeps x and y.
    pub position_n_per_mm: f64,
    /// Stiffness of the turn; 0 keeps it.
    pub turn_n_mm_per_rad: f64,
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
const EXACT: f64 = 1e-7;

/// Move `[x, y, turn]` at which everything balances; `guess` is where the search starts. `k` is the
/// stiffness of one brush, N/mm.
pub(super) fn solve(brushes: &[Brush], k: f64, springs: Springs, guess: [f64; 3]) -> [f64; 3] {
    let pulls = springs.position_n_per_mm > 0.0;
    let turns = springs.turn_n_mm_per_rad > 0.0;
    let free = |v: [f64; 3]| {
        let (shift, turn) = (f64::from(u8::from(pulls)), f64::from(u8::from(turns)));
        [v[0] * shift, v[1] * shift, v[2] * turn]
    };
    if !pulls && !turns {
        return [0.0; 3];
    }
    if brushes.is_empty() {
        return free(springs.stretch);
    }
    let held: f64 = brushes.iter().map(|b| b.cap_n).sum();
    let exact = EXACT * held.max(1e-6);
    let evaluate = |at| {
        if turns { slope::<true>(brushes, k, springs, at) } else { slope::<false>(brushes, k, springs, at) }
    };
    let mut at = free(guess);
    let mut here = evaluate(at);
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
fn slope<const TURN: bool>(brushes: &[Brush], k: f64, springs: Springs, at: [f64; 3]) -> Slope {
    let (kp, kt) = (springs.position_n_per_mm, springs.turn_n_mm_per_rad);
    let left: [f64; 3] = std::array::from_fn(|i| at[i] - springs.stretch[i]);
    let mut energy = 0.5 * kp * (left[0] * left[0] + left[1] * left[1]) + 0.5 * kt * left[2] * left[2];
    let mut force = [kp * left[0], kp * left[1], kt * left[2]];
    let mut h = [kp, 0.0, kp, 0.0, 0.0, kt];
    let soft = 1.0 / k;
    for brush in brushes {
        let t = if TURN {
            brush.trial(k, at)
        } else {
            [brush.held_n[0] + k * at[0], brush.held_n[1] + k * at[1]]
        };
        let (size2, cap) = (t[0] * t[0] + t[1] * t[1], brush.cap_n);
        // Stiffness of this brush: k in full while it sticks, across its slip only while it slides.
        let (f, xx, xy, yy);
        if size2 <= cap * cap {
            energy += 0.5 * soft * size2;
            (f, xx, xy, yy) = (t, k, 0.0, k);
        } else {
            let size = size2.sqrt();
            let share = cap / size;
            energy += soft * cap * (size - 0.5 * cap);
            let (left, along) = (k * share, k * share / size2);
            f = [share * t[0], share * t[1]];
            (xx, xy, yy) = (left - along * t[0] * t[0], -along * t[0] * t[1], left - along * t[1] * t[1]);
        }
        force[0] += f[0];
        force[1] += f[1];
        h[0] += xx;
        h[1] += xy;
        h[2] += yy;
        if TURN {
            let [x, y] = brush.arm_mm;
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
