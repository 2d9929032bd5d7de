//! The Python package `slipsense`: the firmware's pipeline, its messages and its episode files. This crate converts
//! numpy arrays to the library's types and back. `slipsense/__init__.pyi` describes the package for its users.

mod bus;
mod episode;
mod pipeline;

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;

use crate::pipeline::refused;

/// Run the command `slipsense` as its program does; gives the exit code.
#[pyfunction]
fn main(py: Python<'_>, line: Vec<OsString>) -> u8 {
    py.detach(|| slipsense_cli::main(line))
}

/// Run it with these arguments, texts and paths; what is wrong is an error.
#[pyfunction]
#[pyo3(signature = (*arguments))]
fn command(py: Python<'_>, arguments: Vec<PathBuf>) -> PyResult<()> {
    let line = std::iter::once("slipsense".into()).chain(arguments.into_iter().map(OsString::from));
    py.detach(|| slipsense_cli::run(line)).map_err(|error| refused(slipsense_cli::one_line(&error)))
}

#[pymodule]
mod _slipsense {
    #[pymodule_export]
    use crate::bus::{Log, Raw, Receiver, Slip, SlipReceiver};
    #[pymodule_export]
    use crate::episode::{Episode, pressure_table_kpa, run};
    #[pymodule_export]
    use crate::pipeline::{Contact, Output, Pipeline};
    #[pymodule_export]
    use crate::{command, main};
    #[pymodule_export]
    const COL_PITCH_MM: f32 = slipsense::params::COL_PITCH_MM;
    #[pymodule_export]
    const ROW_PITCH_MM: f32 = slipsense::params::ROW_PITCH_MM;
}
