//! Settings: what may be set, how it is stored, what a power cut and damage do to it.

pub mod flash;
mod power_cuts;
mod rules;
