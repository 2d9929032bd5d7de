//! Errors of the library as Python's.

use std::fmt::Display;

use pyo3::PyErr;
use pyo3::exceptions::PyValueError;

/// A rule that the caller broke.
pub fn refused(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
