//! The Python package `slipsense`: the very pipeline of the firmware, its messages and its episode files. What is
//! here turns numpy arrays into the library's types and back; `slipsense/__init__.pyi` says what a user sees.

mod bus;
mod command;
mod episode;
mod error;
mod pipeline;

use pyo3::prelude::*;

#[pymodule]
mod _slipsense {
    #[pymodule_export]
    use crate::bus::{Log, Raw, Receiver, Slip, SlipReceiver};
    #[pymodule_export]
    use crate::command::{command, main};
    #[pymodule_export]
    use crate::episode::{Episode, pressure_table_kpa, run};
    #[pymodule_export]
    use crate::pipeline::{Contact, Output, Pipeline};
    #[pymodule_export]
    const COL_PITCH_MM: f32 = slipsense::params::COL_PITCH_MM;
    #[pymodule_export]
    const ROW_PITCH_MM: f32 = slipsense::params::ROW_PITCH_MM;
}
