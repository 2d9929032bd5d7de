//! Modes of the finger, through which the accelerometer feels every force on the pad:
//! `a = Σ_m φ_m φ_mᵀ F(f) · (−f²) / (f_m² − f² + 2jζ_m f f_m)`, and the mode of an object that rings.

use libm::{exp, pow};
use serde::Serialize;

use super::scene::{Motion, Scene};
use super::signal::{Biquad, add_scaled};
use crate::draw::{Draw, Rng, dot, unit_vector};
use crate::friction::STEP_HZ;
use crate::objects::Kind;
use crate::recipe::{Platform, Region};

/// Range of each mode's frequency, Hz, of a parallel jaw's finger (modelling range).
const UMI_HZ: [(f64, f64); 4] = [(80.0, 180.0), (250.0, 550.0), (700.0, 1500.0), (2200.0, 3500.0)];
/// The same of a jointed finger, whose first modes are the compliance of its joints. The fingertip is the same module
/// on any hand, and with it the upper two modes, [`FINGERTIP`] and above.
const TESOLLO_HZ: [(f64, f64); 4] = [(30.0, 90.0), (120.0, 300.0), UMI_HZ[2], UMI_HZ[3]];
/// Lowest mode of the fingertip itself.
const FINGERTIP: usize = 2;
/// Damping ratio while holding something.
const UMI_DAMPING: (f64, f64) = (0.03, 0.12);
/// The same of a jointed finger's modes below the fingertip's.
const JOINT_DAMPING: (f64, f64) = (0.05, 0.2);
/// Main direction of each mode before its own scatter: x across the finger, y along it, z normal to the
/// pad. A jaw bends towards the object first, a jointed finger flexes along its length.
const UMI_DIRECTION: [[f64; 3]; 4] = [[0.0, 0.4, 0.9], [0.9, 0.4, 0.0], [0.0, 0.9, 0.4], [0.6, 0.6, 0.6]];
const TESOLLO_DIRECTION: [[f64; 3]; 4] =
    [[0.0, 0.8, 0.6], [0.8, 0.0, 0.6], UMI_DIRECTION[2], UMI_DIRECTION[3]];
/// Exponent of a mode's frequency over grip force: a Hertz contact stiffens with F^(1/3), so a mode that
/// it carries alone rises with F^(1/6), and one with a stiffening pad behind it faster.
const GRIP_EXPONENT: (f64, f64) = (1.0 / 6.0, 1.0 / 3.0);
/// Largest shift by grip, both ways from the frequency at [`REFERENCE_N`].
const GRIP_SHIFT: f64 = 0.1;
const REFERENCE_N: f64 = 2.0;
/// Number of the modes of any finger.
const FREE_MODES: (usize, usize) = (3, 9);
/// Change of frequency, damping and participation from grasp to grasp, logarithmic rms.
const GRASP_SPREAD: (f64, f64, f64) = (0.015, 0.08, 0.08);
/// Share of the damping that is left when nothing is held, and the grip at which all of it is there.
const FREE_DAMPING: f64 = 0.5;
const DAMPED_FROM_N: f64 = 1.0;
const CABLE_DAMPING: f64 = 1.4;
/// How loud an object rings: factor on the force along the slip and normal to it.
const OBJECT_GAIN: [f64; 2] = [1.5, 3.0];

#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Mode {
    /// Frequency at 2 N, Hz.
    pub hz: f64,
    /// Damping ratio while holding something.
    pub damping: f64,
    /// Unit vector of the motion in finger axes.
    pub direction: [f64; 3],
    /// Acceleration above resonance per acceleration of the excitation: participation (shape at the pad squared over
    /// modal mass, relative to the finger's mass) times the share that reaches the unit's accelerometer.
    pub weight: f64,
}

/// The modes of one finger, lowest first.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Modes {
    pub modes: Vec<Mode>,
    pub grip_exponent: f64,
}

impl Modes {
    pub(crate) fn draw(rng: &mut Rng, platform: Platform) -> Self {
        let (hz, joints, direction) = match platform {
            Platform::Umi => (UMI_HZ, UMI_DAMPING, UMI_DIRECTION),
            Platform::Tesollo => (TESOLLO_HZ, JOINT_DAMPING, TESOLLO_DIRECTION),
        };
        let coupling = exp(0.2 * rng.normal());
        let mode = |m: usize| Mode {
            hz: rng.log_between(hz[m].0, hz[m].1),
            damping: rng.log_uniform(if m < FINGERTIP { joints } else { UMI_DAMPING }),
            direction: scattered(rng, direction[m], 0.5),
            weight: coupling * rng.log_between(0.4, 1.2),
        };
        Self { modes: (0..hz.len()).map(mode).collect(), grip_exponent: rng.uniform(GRIP_EXPONENT) }
    }

    pub(crate) fn draw_free(rng: &mut Rng) -> Self {
        let count = rng.count(FREE_MODES.0, FREE_MODES.1);
        let mode = |_| Mode {
            hz: rng.log_between(30.0, 3_700.0),
            damping: rng.log_between(0.01, 0.35),
            direction: rng.direction(),
            weight: rng.log_between(0.15, 2.0),
        };
        let modes = (0..count).map(mode).collect();
        Self { modes, grip_exponent: rng.uniform(GRIP_EXPONENT) }
    }

    /// The same finger in one grasp: nearly as built, and otherwise excited near the palm.
    pub(crate) fn in_grasp(&self, rng: &mut Rng, region: Region) -> Self {
        let mut grasp = self.clone();
        for (m, mode) in grasp.modes.iter_mut().enumerate() {
            mode.hz *= exp(GRASP_SPREAD.0 * rng.normal());
            mode.damping *= exp(GRASP_SPREAD.1 * rng.normal());
            mode.weight *= exp(GRASP_SPREAD.2 * rng.normal());
            if region == Region::Palm {
                // The first mode moves the pad less and the others more, and all are a little stiffer.
                let weight = if m == 0 { (0.4, 0.7) } else { (1.0, 1.6) };
                mode.weight *= rng.uniform(weight);
                mode.hz *= rng.between(1.02, 1.12);
                mode.direction = scattered(rng, mode.direction, 0.3);
            }
        }
        grasp
    }

    /// Factor on every frequency at this grip.
    pub(crate) fn shift(&self, grip_n: f64) -> f64 {
        pow(grip_n.max(1e-3) / REFERENCE_N, self.grip_exponent).clamp(1.0 - GRIP_SHIFT, 1.0 + GRIP_SHIFT)
    }

    /// Replace the excitation `motion` by the acceleration under it.
    pub(crate) fn respond(&self, scene: &Scene<'_>, ring: Option<&ObjectMode>, motion: &mut Motion) {
        let rate_hz = motion.clock.rate_hz;
        let held_damping = if scene.object.kind == Kind::Cable { CABLE_DAMPING } else { 1.0 };
        let tuned = |mode: &Mode, grip_n: f64| {
            let held = (grip_n / DAMPED_FROM_N).clamp(0.0, 1.0);
            let damping = mode.damping * (FREE_DAMPING + (held_damping - FREE_DAMPING) * held);
            let hz = (mode.hz * self.shift(grip_n)).min(0.48 * rate_hz);
            Biquad::resonant_highpass(hz, damping, rate_hz)
        };
        let mut filters: Vec<_> = self.modes.iter().map(|mode| tuned(mode, 0.0)).collect();
        let mut ring = ring.map(|r| Biquad::bandpass(r.hz, r.damping, rate_hz));
        let (mut tuned_n, mut last_step) = (0.0f64, usize::MAX);
        let mut grip = 0.0;
        for (t, input) in motion.samples() {
            let step = (t * STEP_HZ) as usize;
            if step != last_step {
                last_step = step;
                grip = scene.timeline.grip_n[step.min(scene.timeline.grip_n.len() - 1)];
                if (grip - tuned_n).abs() > 0.01 * tuned_n + 0.002 {
                    tuned_n = grip;
                    for (filter, mode) in filters.iter_mut().zip(&self.modes) {
                        filter.retune(tuned(mode, grip));
                    }
                }
            }
            if let Some(ring) = &mut ring {
                let tone = ring.next(if grip > super::scene::TOUCHED_N { input[1] + input[2] } else { 0.0 });
                input[1] += OBJECT_GAIN[0] * tone;
                input[2] += OBJECT_GAIN[1] * tone;
            }
            let mut out = [0.0; 3];
            for (mode, filter) in self.modes.iter().zip(&mut filters) {
                let y = mode.weight * filter.next(dot(mode.direction, *input));
                add_scaled(&mut out, y, mode.direction);
            }
            *input = out;
        }
    }
}

/// A unit vector near `main`.
fn scattered(rng: &mut Rng, main: [f64; 3], scatter: f64) -> [f64; 3] {
    let own = rng.direction();
    unit_vector(std::array::from_fn(|a| main[a] + scatter * own[a]))
}

#[derive(Clone, Debug, Serialize)]
pub(crate) struct ObjectMode {
    pub hz: f64,
    pub damping: f64,
}

impl ObjectMode {
    /// `hz` is the catalogue's; 0 for an object that does not ring.
    pub(crate) fn draw(rng: &mut Rng, hz: f64) -> Option<Self> {
        let (spread, damping) = (exp(0.03 * rng.normal()), rng.log_between(0.005, 0.02));
        (hz > 0.0).then_some(Self { hz: hz * spread, damping })
    }
}
