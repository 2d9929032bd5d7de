//! The Python package `slipsense`: the very pipeline of the firmware, its messages and its episode files. What is
//! here turns numpy arrays into the library's types and back; `slipsense/__init__.pyi` says what a user sees.

mod bus;
mod episode;
mod error;
mod pipeline;

use pyo3::prelude::*;

#[pymodule]
mod _slipsense {
    #[pymodule_export]
    use crate::bus::{Log, Raw, Receiver, Slip, SlipReceiver};
    #[pymodule_export]
    use crate::episode::{Episode, run};
    #[pymodule_export]
    use crate::pipeline::{Contact, Output, Pipeline};
}
