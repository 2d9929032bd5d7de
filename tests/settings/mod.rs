//! Settings: what may be set, how it is stored, what a power cut and damage do to it.

mod power_cuts;
mod rules;
