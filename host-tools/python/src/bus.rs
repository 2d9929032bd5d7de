//! Messages of a module on a bus.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use slipsense::fixed::Q;
use slipsense::health;
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense::wire::{
    CanFrame, NodeId, Received, Receiver as Frames, Region, SlipMessage, SlipReceiver as Protected,
};
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};

use crate::pipeline::{Contact, contacts, refused};

/// The decision of one frame, as sent.
#[pyclass(module = "slipsense", frozen, get_all)]
pub struct Slip {
    timestamp_us: u64,
    sequence: u32,
    class_index: u8,
    slip: bool,
    may_begin: bool,
    locked: bool,
    invalid: u8,
    degraded: u8,
    starts: u8,
    configuration: u16,
    late_frames: u8,
    logits_q8: Py<PyArray1<i16>>,
    log_odds_q8: i16,
    contact: Vec<Contact>,
}

impl Slip {
    fn new(py: Python<'_>, message: &SlipMessage) -> Self {
        Self {
            timestamp_us: message.timestamp_us,
            sequence: message.sequence,
            class_index: message.class,
            slip: message.slip,
            may_begin: message.may_begin,
            locked: message.locked,
            invalid: message.invalid,
            degraded: message.degraded,
            starts: message.starts,
            configuration: message.configuration,
            late_frames: message.late_frames,
            logits_q8: message.logits.map(Q::to_bits).to_vec().into_pyarray(py).unbind(),
            log_odds_q8: message.log_odds.to_bits(),
            contact: contacts(message),
        }
    }
}

#[pymethods]
impl Slip {
    fn __repr__(&self) -> String {
        let Self { sequence, class_index, slip, invalid, .. } = self;
        format!("Slip(sequence={sequence}, class_index={class_index}, slip={slip}, invalid={invalid})")
    }
}

/// What one sensor delivered for one frame, as sent.
#[pyclass(module = "slipsense", frozen, get_all)]
pub struct Raw {
    timestamp_us: u64,
    sequence: u32,
    sensor: u8,
    health: u8,
    /// None where the array did not deliver, or the bus was too full.
    piezo: Option<Py<PyAny>>,
    /// First row, rows, first column, columns of the taxels that were sent; the others read 0 and are not known.
    region: (u8, u8, u8, u8),
    /// None where the accelerometer did not deliver.
    xl: Option<Py<PyAny>>,
    xl_end: u32,
    xl_dropped: u8,
}

#[pymethods]
impl Raw {
    fn __repr__(&self) -> String {
        format!("Raw(sequence={}, sensor={})", self.sequence, self.sensor)
    }
}

fn message(py: Python<'_>, received: Received) -> PyResult<Py<PyAny>> {
    Ok(match received {
        Received::Slip(message) => Py::new(py, Slip::new(py, &message))?.into_any(),
        Received::Raw(message) => {
            let region = message.known();
            let counts = message.piezo.counts().to_vec().into_pyarray(py);
            let counts = counts.reshape([TAXEL_ROWS, TAXEL_COLS])?.into_any().unbind();
            let samples = message.xl.concat().into_pyarray(py);
            let samples = samples.reshape([message.xl.len(), XL_AXES])?.into_any().unbind();
            let raw = Raw {
                timestamp_us: message.timestamp_us,
                sequence: message.sequence,
                sensor: message.sensor,
                health: message.health,
                piezo: (region != Region::NONE).then_some(counts),
                region: region.to_bytes().into(),
                xl: (message.health & health::XL_MISSING == 0).then_some(samples),
                xl_end: message.xl_end,
                xl_dropped: message.xl_dropped,
            };
            Py::new(py, raw)?.into_any()
        }
    })
}

fn address(node: u8) -> PyResult<NodeId> {
    NodeId::new(node).ok_or_else(|| refused(format!("node {node}: must be at most 127")))
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
        Ok(Self { frames: Frames::new(address(node)?), errors: 0 })
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

/// Slip messages of one module, checked; what a controller acts on.
#[pyclass(module = "slipsense")]
pub struct SlipReceiver(Protected);

#[pymethods]
impl SlipReceiver {
    #[new]
    #[pyo3(signature = (node=NodeId::DEFAULT.get()))]
    fn new(node: u8) -> PyResult<Self> {
        Ok(Self(Protected::new(address(node)?)))
    }

    /// Take the data of a slip frame: "ok", "some lost", "repeated", "wrong sequence", "delayed" or "error".
    fn receive(&mut self, data: &[u8], now_us: u64) -> &'static str {
        ["ok", "some lost", "repeated", "wrong sequence", "delayed", "error"]
            [self.0.receive(data, now_us) as usize]
    }

    /// "no data", "starting", "valid" or "invalid".
    fn state(&self, now_us: u64) -> &'static str {
        ["no data", "starting", "valid", "invalid"][self.0.state(now_us) as usize]
    }

    /// The flag is up and may be believed.
    fn slip(&self, now_us: u64) -> bool {
        self.0.slip(now_us)
    }

    /// The message accepted last.
    #[getter]
    fn message(&self, py: Python<'_>) -> Option<Slip> {
        self.0.message().map(|message| Slip::new(py, message))
    }

    /// Messages that are known to be lost.
    #[getter]
    fn lost(&self) -> u32 {
        self.0.lost
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
        let name = path.display().to_string();
        let file = File::open(&path).map_err(|error| refused(format!("{name}: cannot read: {error}")))?;
        let lines = CandumpReader::new(Box::new(BufReader::new(file)) as Box<dyn BufRead + Send + Sync>);
        Ok(Self { lines, name, receiver: Receiver::new(node)? })
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
