//! The `slipsense` command inside the interpreter.

use std::ffi::OsString;
use std::path::PathBuf;

use pyo3::prelude::*;

use crate::error::refused;

/// Run it as its program does; gives the exit code.
#[pyfunction]
pub fn main(py: Python<'_>, line: Vec<OsString>) -> u8 {
    py.detach(|| slipsense_cli::main(line))
}

/// Run it with these arguments, texts and paths; what is wrong is an error.
#[pyfunction]
#[pyo3(signature = (*arguments))]
pub fn command(py: Python<'_>, arguments: Vec<PathBuf>) -> PyResult<()> {
    let line = std::iter::once("slipsense".into()).chain(arguments.into_iter().map(OsString::from));
    py.detach(|| slipsense_cli::run(line)).map_err(|error| refused(slipsense_cli::one_line(&error)))
}
