//! Messages of a module on a bus.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use slipsense::fixed::Q;
use slipsense::health;
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense::wire::{CanFrame, NodeId, RawMessage, Received, Receiver as Frames, SlipMessage};
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};

use crate::pipeline::Contact;
use crate::refused;

/// The decision of one frame, as sent.
#[pyclass(module = "slipsense", frozen)]
pub struct Slip(SlipMessage);

#[pymethods]
impl Slip {
    #[getter]
    fn timestamp_us(&self) -> u64 {
        self.0.timestamp_us
    }

    #[getter]
    fn sequence(&self) -> u32 {
        self.0.sequence
    }

    #[getter]
    fn class_index(&self) -> u8 {
        self.0.class
    }

    #[getter]
    fn slip(&self) -> bool {
        self.0.slip
    }

    #[getter]
    fn alarm(&self) -> bool {
        self.0.alarm
    }

    #[getter]
    fn logits_q10<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i32>> {
        self.0.logits.map(Q::to_bits).to_vec().into_pyarray(py)
    }

    #[getter]
    fn late_frames(&self) -> u16 {
        self.0.late_frames
    }

    #[getter]
    fn contact(&self) -> Vec<Contact> {
        self.0.contact.iter().take(usize::from(self.0.sensors)).map(Contact::from).collect()
    }

    fn __repr__(&self) -> String {
        let Self(m) = self;
        format!("Slip(sequence={}, class_index={}, slip={}, alarm={})", m.sequence, m.class, m.slip, m.alarm)
    }
}

/// What one sensor delivered for one frame, as sent.
#[pyclass(module = "slipsense", frozen)]
pub struct Raw(RawMessage);

#[pymethods]
impl Raw {
    #[getter]
    fn timestamp_us(&self) -> u64 {
        self.0.timestamp_us
    }

    #[getter]
    fn sequence(&self) -> u32 {
        self.0.sequence
    }

    #[getter]
    fn sensor(&self) -> u8 {
        self.0.sensor
    }

    #[getter]
    fn health(&self) -> u8 {
        self.0.health
    }

    /// None where the array did not deliver.
    #[getter]
    fn piezo<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        if self.0.health & health::PIEZO_MISSING != 0 {
            return Ok(None);
        }
        let counts = self.0.piezo.counts().to_vec().into_pyarray(py);
        Ok(Some(counts.reshape([TAXEL_ROWS, TAXEL_COLS])?.into_any()))
    }

    /// None where the accelerometer did not deliver.
    #[getter]
    fn xl<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyAny>>> {
        if self.0.health & health::XL_MISSING != 0 {
            return Ok(None);
        }
        let samples = self.0.xl.concat().into_pyarray(py);
        Ok(Some(samples.reshape([self.0.xl.len(), XL_AXES])?.into_any()))
    }

    #[getter]
    fn xl_end(&self) -> u32 {
        self.0.xl_end
    }

    fn __repr__(&self) -> String {
        format!("Raw(sequence={}, sensor={})", self.0.sequence, self.0.sensor)
    }
}

fn message(py: Python<'_>, received: Received) -> PyResult<Py<PyAny>> {
    Ok(match received {
        Received::Slip(slip) => Py::new(py, Slip(slip))?.into_any(),
        Received::Raw(raw) => Py::new(py, Raw(raw))?.into_any(),
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
