//! Messages of a module on a bus.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use slipsense::fixed::Q;
use slipsense::health;
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense::wire::{CanFrame, NodeId, Received, Receiver as Frames};
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};

use crate::error::refused;
use crate::pipeline::{Contact, contacts};

/// The decision of one frame, as sent.
#[pyclass(module = "slipsense", frozen, get_all)]
pub struct Slip {
    timestamp_us: u64,
    sequence: u32,
    class_index: u8,
    slip: bool,
    alarm: bool,
    logits_q10: Py<PyArray1<i32>>,
    late_frames: u16,
    contact: Vec<Contact>,
}

#[pymethods]
impl Slip {
    fn __repr__(&self) -> String {
        let Self { sequence, class_index, slip, alarm, .. } = self;
        format!("Slip(sequence={sequence}, class_index={class_index}, slip={slip}, alarm={alarm})")
    }
}

/// What one sensor delivered for one frame, as sent.
#[pyclass(module = "slipsense", frozen, get_all)]
pub struct Raw {
    timestamp_us: u64,
    sequence: u32,
    sensor: u8,
    health: u8,
    /// None where the array did not deliver.
    piezo: Option<Py<PyAny>>,
    /// None where the accelerometer did not deliver.
    xl: Option<Py<PyAny>>,
    xl_end: u32,
}

#[pymethods]
impl Raw {
    fn __repr__(&self) -> String {
        format!("Raw(sequence={}, sensor={})", self.sequence, self.sensor)
    }
}

fn message(py: Python<'_>, received: Received) -> PyResult<Py<PyAny>> {
    Ok(match received {
        Received::Slip(message) => {
            let slip = Slip {
                timestamp_us: message.timestamp_us,
                sequence: message.sequence,
                class_index: message.class,
                slip: message.slip,
                alarm: message.alarm,
                logits_q10: message.logits.map(Q::to_bits).to_vec().into_pyarray(py).unbind(),
                late_frames: message.late_frames,
                contact: contacts(&message),
            };
            Py::new(py, slip)?.into_any()
        }
        Received::Raw(message) => {
            let delivered = |missing: u8| message.health & missing == 0;
            let counts = message.piezo.counts().to_vec().into_pyarray(py);
            let counts = counts.reshape([TAXEL_ROWS, TAXEL_COLS])?.into_any().unbind();
            let samples = message.xl.concat().into_pyarray(py);
            let samples = samples.reshape([message.xl.len(), XL_AXES])?.into_any().unbind();
            let raw = Raw {
                timestamp_us: message.timestamp_us,
                sequence: message.sequence,
                sensor: message.sensor,
                health: message.health,
                piezo: delivered(health::PIEZO_MISSING).then_some(counts),
                xl: delivered(health::XL_MISSING).then_some(samples),
                xl_end: message.xl_end,
            };
            Py::new(py, raw)?.into_any()
        }
    })
}

/// Puts the CAN frames of one module together.
#[pyclass(module = "slipsense")]
pub struct Receiver {
    frames: Frames,
    /// Frames that fitted nothing, and messages that could not be read.
    #[pyo3(get)]
    errors: u64,
}

impl Receiver {
    fn at(node: u8) -> PyResult<Self> {
        let node = NodeId::new(node).ok_or_else(|| refused(format!("node {node}: must be at most 127")))?;
        Ok(Self { frames: Frames::new(node), errors: 0 })
    }

    fn take(&mut self, frame: &CanFrame) -> Option<Received> {
        self.frames.accept(frame).unwrap_or_else(|_| {
            self.errors += 1;
            None
        })
    }
}

#[pymethods]
impl Receiver {
    #[new]
    #[pyo3(signature = (node=NodeId::DEFAULT.get()))]
    fn new(node: u8) -> PyResult<Self> {
        Self::at(node)
    }

    /// Transfers lost so far, as far as their 5-bit identifiers tell.
    #[getter]
    fn missed(&self) -> u32 {
        self.frames.missed()
    }

    fn accept(&mut self, py: Python<'_>, can_id: u32, data: &[u8]) -> PyResult<Option<Py<PyAny>>> {
        let frame = CanFrame::new(can_id, data).map_err(refused)?;
        self.take(&frame).map(|received| message(py, received)).transpose()
    }
}

/// Messages of a candump log, in order.
#[pyclass(module = "slipsense")]
pub struct Log {
    lines: CandumpReader<Box<dyn BufRead + Send + Sync>>,
    name: String,
    receiver: Receiver,
}

#[pymethods]
impl Log {
    #[new]
    #[pyo3(signature = (path, node=NodeId::DEFAULT.get()))]
    fn new(path: PathBuf, node: u8) -> PyResult<Self> {
        let file = File::open(&path)?;
        let lines = CandumpReader::new(Box::new(BufReader::new(file)) as Box<dyn BufRead + Send + Sync>);
        Ok(Self { lines, name: path.display().to_string(), receiver: Receiver::at(node)? })
    }

    #[getter]
    fn errors(&self) -> u64 {
        self.receiver.errors
    }

    #[getter]
    fn missed(&self) -> u32 {
        self.receiver.missed()
    }

    fn __iter__(this: PyRef<'_, Self>) -> PyRef<'_, Self> {
        this
    }

    /// The time of the log, microseconds, and the message.
    fn __next__(&mut self, py: Python<'_>) -> PyResult<Option<(u64, Py<PyAny>)>> {
        for entry in self.lines.by_ref() {
            let entry = match entry {
                Ok(entry) => entry,
                Err(CandumpError { rule: Rule::NotOurs, .. }) => continue,
                Err(error) => return Err(refused(format!("{}: {error}", self.name))),
            };
            if let Some(received) = self.receiver.take(&entry.frame) {
                return Ok(Some((entry.timestamp_us, message(py, received)?)));
            }
        }
        Ok(None)
    }
}
