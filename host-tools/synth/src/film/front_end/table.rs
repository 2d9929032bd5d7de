//! Made by `cargo xtask front-end --write` from the simulation of the front end: do not edit.

/// Code of an untouched taxel.
pub const IDLE: f64 = 2944.3;

/// Codes above idle of a lone taxel at 5 MPa.
pub const FULL_SCALE: f64 = 56977.0;

/// Drop of the row's drive, share per taxel of the row at full scale.
pub const ROW_DROP: f64 = 4.4994e-05;

/// The same of its column.
pub const COL_DROP: f64 = 1.1323e-05;

/// Codes per µV of offset of the column's amplifier.
pub const OFFSET_PER_UV: f64 = -0.059895;

/// Codes per µV more for each taxel of the column at full scale.
pub const LEAK_PER_UV: f64 = -0.027281;

/// Noise of an idle column and of the ADC, codes rms.
pub const NOISE: f64 = 4.3549;

/// Variance of it, codes², for each taxel of the column at full scale.
pub const NOISE_PER_LOAD: f64 = 0.50037;

/// The same for the square of their number.
pub const NOISE_PER_LOAD2: f64 = 0.0060436;

/// Code at which the output stage ends.
pub const CLIP: f64 = 62823.0;

/// Largest error of settling, codes: of a step from full scale to idle and other transitions.
pub const RESIDUAL: f64 = 3.1749;
