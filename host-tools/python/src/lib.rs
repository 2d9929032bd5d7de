//! The Python package `slipsense`: the very pipeline of the firmware, its messages and its episode files. What is
//! here turns numpy arrays into the library's types and back; `slipsense/__init__.pyi` says what a user sees.

mod bus;
mod episode;
mod pipeline;

use std::fmt::Display;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

/// A rule that the caller broke.
fn refused(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

#[pymodule]
mod _slipsense {
    #[pymodule_export]
    use crate::bus::{Log, Raw, Receiver, Slip};
    #[pymodule_export]
    use crate::episode::{Episode, run};
    #[pymodule_export]
    use crate::pipeline::{Contact, Output, Pipeline};
}
