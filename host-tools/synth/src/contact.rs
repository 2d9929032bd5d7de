//! Contact pressure: an elastic layer on a stiff backing (Winkler foundation) indented by the object.
//!
//! `p = K · max(0, depth − gap(x, y))`, with the depth that makes the pressures carry the grip force.
//! The pressure is then spread over neighbours, as a layer of finite thickness does, and rescaled.
//! Pressure is taken at the centre of each 0.7 × 0.92 mm cell and stands for the whole cell.

use libm::{cos, exp, sin, sincos};
use slipsense::params::{COL_PITCH_MM, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use slipsense::sensor::active_cols;

use crate::draw::{Draw, Rng};
use crate::objects::{Object, Shape};

/// Area of one cell, mm²: pressure in kPa times this is force in mN.
pub const CELL_MM2: f64 = COL_PITCH_MM as f64 * ROW_PITCH_MM as f64;

/// Centre of a cell in the pad's frame: x along columns, y along rows, origin in the middle.
pub(crate) fn cell_mm(index: usize) -> (f64, f64) {
    let (row, col) = (index / TAXEL_COLS, index % TAXEL_COLS);
    (
        (col as f64 - (TAXEL_COLS as f64 - 1.0) / 2.0) * COL_PITCH_MM as f64,
        (row as f64 - (TAXEL_ROWS as f64 - 1.0) / 2.0) * ROW_PITCH_MM as f64,
    )
}

/// Where an object lies on a pad.
#[derive(Clone, Copy, Debug)]
pub struct Pose {
    /// Centre across the slip direction.
    pub x_mm: f64,
    /// Centre along the slip direction.
    pub y_mm: f64,
    /// Angle between the object's axis and the slip direction.
    pub yaw_rad: f64,
    /// Slope of the object's face across and along its axis.
    pub tilt: [f64; 2],
}

/// Height of the object's face above its highest point, at `(u, v)` mm from its centre, `u` across and
/// `v` along its axis; infinite where there is no object.
pub fn gap_mm(object: &Object, u: f64, v: f64) -> f64 {
    let bare = match object.shape {
        Shape::Cylinder { radius_mm: r, length_mm } => {
            if u.abs() < r && v.abs() < length_mm / 2.0 {
                r - (r * r - u * u).sqrt()
            } else {
                f64::INFINITY
            }
        }
        Shape::Sphere { radius_mm: r } => {
            let d2 = u * u + v * v;
            if d2 < r * r { r - (r * r - d2).sqrt() } else { f64::INFINITY }
        }
        Shape::Flat { width_mm, length_mm, edge_mm: r } => {
            let out_u = (u.abs() - width_mm / 2.0 + r).max(0.0);
            let out_v = (v.abs() - length_mm / 2.0 + r).max(0.0);
            let d2 = out_u * out_u + out_v * out_v;
            if d2 < r * r { r - (r * r - d2).sqrt() } else { f64::INFINITY }
        }
    };
    if object.relief_depth_mm == 0.0 {
        return bare;
    }
    let wave = cos(std::f64::consts::TAU * v / object.relief_pitch_mm);
    bare + object.relief_depth_mm * (0.5 - 0.5 * wave)
}

/// Elastic layer of one finger with the object it touches.
pub struct Contact {
    object: &'static Object,
    pose: Pose,
    stiffness_kpa_per_mm: f64,
    kernel: [[f64; 5]; 2],
    waves: [Wave; 6],
    /// Gap of each cell under the object, with the cell.
    gaps: Vec<(f64, usize)>,
    shift_mm: f64,
}

/// How an object rocks in the grip without slipping: slowly by itself, and with the grip force.
pub(crate) struct Rocking {
    wander: [(f64, f64, f64); 4],
    with_force: [f64; 2],
}

impl Rocking {
    pub(crate) fn draw(rng: &mut Rng) -> Self {
        Self {
            wander: std::array::from_fn(|_| {
                (rng.log_between(0.2, 3.0), rng.log_between(0.2e-3, 2e-3), rng.phase())
            }),
            with_force: [0.002 * rng.normal(), 0.002 * rng.normal()],
        }
    }

    /// Slopes at time `t` under `excess` = F / F at the start of the grip − 1.
    pub(crate) fn at(&self, t: f64, excess: f64) -> [f64; 2] {
        std::array::from_fn(|axis| {
            let wander = self.wander[2 * axis..2 * axis + 2]
                .iter()
                .map(|(hz, slope, phase)| slope * sin(std::f64::consts::TAU * hz * t + phase));
            wander.sum::<f64>() + self.with_force[axis] * excess
        })
    }
}

/// One component of the uneven surface: it travels with the object.
struct Wave {
    k_per_mm: [f64; 2],
    phase: f64,
    depth: f64,
}

/// Pressures of one sensor, with the cells that carry any.
#[derive(Clone)]
pub struct PressureMap {
    /// Row-major, kPa.
    pub kpa: Box<[f64; TAXELS]>,
    /// Cells with pressure, in rising order.
    pub loaded: Vec<usize>,
}

impl PressureMap {
    /// Nothing touches.
    pub fn empty() -> Self {
        Self { kpa: Box::new([0.0; TAXELS]), loaded: Vec::new() }
    }

    /// Force that the pressures carry, newtons.
    pub fn force_n(&self) -> f64 {
        self.loaded.iter().map(|&i| self.kpa[i]).sum::<f64>() * CELL_MM2 * 1e-3
    }
}

impl Contact {
    /// A finger's layer drawn from the field range (1–6 MPa per mm, spread of 0.3–0.6 mm) under an object.
    pub(crate) fn draw(rng: &mut Rng, object: &'static Object, pose: Pose) -> Self {
        let layer = rng.log_between(1200.0, 5000.0);
        let spread = rng.between(0.3, 0.6);
        let waves = std::array::from_fn(|_| {
            let (k, angle) = (std::f64::consts::TAU / rng.log_between(1.0, 7.0), rng.phase());
            Wave {
                k_per_mm: [k * cos(angle), k * sin(angle)],
                phase: rng.phase(),
                depth: rng.between(0.004, 0.02),
            }
        });
        let mut contact = Self::new(object, pose, layer, spread);
        contact.waves = waves;
        contact
    }

    /// A layer of given stiffness and spread (Gaussian sigma, 0 for none), on an even surface.
    pub fn new(object: &'static Object, pose: Pose, layer_kpa_per_mm: f64, spread_mm: f64) -> Self {
        let kernel = |pitch: f32| {
            let mut taps: [f64; 5] = std::array::from_fn(|i| {
                let d = (i as f64 - 2.0) * pitch as f64;
                let z = d / spread_mm.max(1e-6);
                if i == 2 { 1.0 } else { exp(-0.5 * z * z) }
            });
            let sum: f64 = taps.iter().sum();
            taps.iter_mut().for_each(|t| *t /= sum);
            taps
        };
        let mut contact = Self {
            object,
            pose,
            stiffness_kpa_per_mm: 1.0 / (1.0 / layer_kpa_per_mm + 1.0 / object.layer_kpa_per_mm),
            kernel: [kernel(ROW_PITCH_MM), kernel(COL_PITCH_MM)],
            waves: std::array::from_fn(|_| Wave { k_per_mm: [0.0; 2], phase: 0.0, depth: 0.0 }),
            gaps: Vec::new(),
            shift_mm: 0.0,
        };
        contact.place(0.0, [0.0; 2]);
        contact
    }

    /// Move the object by `shift_mm` along the slip direction from where it was gripped, and let it rock
    /// by `rock` (slopes across and along its axis).
    pub fn place(&mut self, shift_mm: f64, rock: [f64; 2]) {
        self.shift_mm = shift_mm;
        let (sin, cos) = sincos(self.pose.yaw_rad);
        let tilt = [self.pose.tilt[0] + rock[0], self.pose.tilt[1] + rock[1]];
        self.gaps.clear();
        for row in 0..TAXEL_ROWS {
            for col in active_cols(row) {
                let cell = row * TAXEL_COLS + col;
                let (x, y) = cell_mm(cell);
                let (dx, dy) = (x - self.pose.x_mm, y - self.pose.y_mm - shift_mm);
                let (u, v) = (dx * cos + dy * sin, dy * cos - dx * sin);
                let gap = gap_mm(self.object, u, v) + tilt[0] * u + tilt[1] * v;
                if gap.is_finite() {
                    self.gaps.push((gap, cell));
                }
            }
        }
    }

    /// Indentation at which the layer carries `force_n`. The force rises with depth in straight pieces
    /// that only get steeper, so Newton steps settle within a few, from above after the first.
    fn depth_mm(&self, force_n: f64) -> f64 {
        let load_mm = force_n * 1e3 / (self.stiffness_kpa_per_mm * CELL_MM2);
        let highest = self.gaps.iter().fold(f64::INFINITY, |a, g| a.min(g.0));
        // One cell alone would carry it here: never too shallow.
        let mut depth = highest + load_mm;
        for _ in 0..60 {
            let (mut sum, mut touching) = (0.0, 0.0);
            for &(gap, _) in &self.gaps {
                if gap < depth {
                    sum += depth - gap;
                    touching += 1.0;
                }
            }
            let step = (sum - load_mm) / f64::max(touching, 1.0);
            depth -= step;
            if step.abs() < 1e-9 {
                break;
            }
        }
        depth
    }

    /// Pressures under a grip of `force_n` newtons sheared by `shear` = lean · Q / F: the shear tilts the
    /// pressure towards the leading edge. Empty where there is no force or no object on the pad.
    pub fn pressures(&self, force_n: f64, shear: f64, out: &mut PressureMap) {
        for &cell in &out.loaded {
            out.kpa[cell] = 0.0;
        }
        out.loaded.clear();
        if force_n <= 0.0 || self.gaps.is_empty() {
            return;
        }
        let depth = self.depth_mm(force_n);
        let mut sharp = [0.0; TAXELS];
        let (mut rows, mut cols) = ((TAXEL_ROWS, 0), (TAXEL_COLS, 0));
        let (mut centre, mut extent, mut total) = (0.0, 0.0f64, 0.0);
        for &(gap, cell) in self.gaps.iter().filter(|g| g.0 < depth) {
            let (x, y) = cell_mm(cell);
            let (dx, dy) = (x - self.pose.x_mm, y - self.pose.y_mm - self.shift_mm);
            let uneven: f64 = self
                .waves
                .iter()
                .map(|w| w.depth * cos(w.k_per_mm[0] * dx + w.k_per_mm[1] * dy + w.phase))
                .sum();
            let p = self.stiffness_kpa_per_mm * (depth - gap).max(0.0) * (1.0 + uneven);
            sharp[cell] = p;
            total += p;
            centre += p * y;
            rows = (rows.0.min(cell / TAXEL_COLS), rows.1.max(cell / TAXEL_COLS));
            cols = (cols.0.min(cell % TAXEL_COLS), cols.1.max(cell % TAXEL_COLS));
        }
        centre /= total.max(1e-12);
        for &(_, cell) in self.gaps.iter().filter(|g| g.0 < depth) {
            extent = extent.max((cell_mm(cell).1 - centre).abs());
        }
        self.spread(&sharp, (rows, cols), out);
        let lean = shear / extent.max(ROW_PITCH_MM as f64);
        for &cell in &out.loaded {
            let tilt = (lean * (cell_mm(cell).1 - centre)).clamp(-0.9, 0.9);
            out.kpa[cell] *= 1.0 + tilt;
        }
        let scale = force_n / out.force_n().max(1e-12);
        for &cell in &out.loaded {
            out.kpa[cell] *= scale;
        }
    }

    /// Separable Gaussian over the touched rectangle and two cells around it.
    fn spread(
        &self,
        sharp: &[f64; TAXELS],
        (rows, cols): ((usize, usize), (usize, usize)),
        out: &mut PressureMap,
    ) {
        let row_range = rows.0.saturating_sub(2)..=(rows.1 + 2).min(TAXEL_ROWS - 1);
        let col_range = cols.0.saturating_sub(2)..=(cols.1 + 2).min(TAXEL_COLS - 1);
        let mut along = [0.0; TAXELS];
        for row in rows.0..=rows.1 {
            for col in col_range.clone() {
                along[row * TAXEL_COLS + col] = taps(&self.kernel[1], col, TAXEL_COLS)
                    .map(|(w, c)| w * sharp[row * TAXEL_COLS + c])
                    .sum();
            }
        }
        for row in row_range {
            for col in col_range.clone().filter(|c| active_cols(row).contains(c)) {
                let p: f64 = taps(&self.kernel[0], row, TAXEL_ROWS)
                    .map(|(w, r)| w * along[r * TAXEL_COLS + col])
                    .sum();
                if p > 1e-6 {
                    out.kpa[row * TAXEL_COLS + col] = p;
                    out.loaded.push(row * TAXEL_COLS + col);
                }
            }
        }
    }
}

/// Kernel taps around `at` that fall inside `0..len`, with the cell each reads.
fn taps(kernel: &[f64; 5], at: usize, len: usize) -> impl Iterator<Item = (f64, usize)> + '_ {
    kernel.iter().enumerate().filter_map(move |(i, &w)| {
        let cell = (at + i).checked_sub(2)?;
        (cell < len).then_some((w, cell))
    })
}
