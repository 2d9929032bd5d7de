//! One frame in, one decision out.

use std::fmt::Display;

use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use self_cell::self_cell;
use slipsense::fixed::Q;
use slipsense::net::{Aligned, Model};
use slipsense::params::{MAX_SENSORS, TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense::pipeline::{FrameStamp, Pipeline as Pipe};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{Origin, SlipMessage};
use slipsense_recording::logmel_std;

/// A rule that the caller broke, as Python's error.
pub(crate) fn refused(error: impl Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}

/// The network that the firmware carries.
static BUNDLED: &Aligned<[u8]> = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet"));

self_cell!(
    /// A pipeline and the model that it reads.
    struct Owned {
        owner: Vec<u8>,
        #[covariant]
        dependent: Pipe,
    }
);

/// A pipeline with a model of its own, the bundled one if none is given.
pub(crate) struct Running(Owned);

impl Running {
    pub(crate) fn new(sensors: usize, model: Option<&[u8]>) -> PyResult<Self> {
        Owned::try_new(model.unwrap_or(&BUNDLED.0).to_vec(), |model| {
            let model = Model::parse(model).map_err(|error| refused(format!("model: {error}")))?;
            Pipe::new(model, sensors).map_err(refused)
        })
        .map(Self)
    }

    pub(crate) fn step(&mut self, inputs: &[SensorInput<'_>]) -> slipsense::pipeline::Output {
        self.0.with_dependent_mut(|_, pipeline| pipeline.step(inputs))
    }
}

/// The signal path of one module.
#[pyclass(module = "slipsense")]
pub struct Pipeline {
    running: Running,
    #[pyo3(get)]
    sensors: usize,
    /// Index of the sample after the last, by sensor.
    xl_end: [u32; MAX_SENSORS],
}

type Scan<'py> = Option<PyReadonlyArray2<'py, u16>>;
type Samples<'py> = Option<PyReadonlyArray2<'py, i16>>;

/// A scan and the samples that came with it, either of which may be missing; with the index of the sample after the
/// last, if samples may be missing in between.
#[derive(FromPyObject)]
enum Part<'py> {
    Counted((Scan<'py>, Samples<'py>, u32)),
    Continuous((Scan<'py>, Samples<'py>)),
}

const PART: &str = "must be (piezo, xl) or (piezo, xl, xl_end): piezo uint16 [32, 32] or None, xl int16 [n, 3] or None, \
                    xl_end 0 to 2^32 - 1";

#[pymethods]
impl Pipeline {
    #[new]
    #[pyo3(signature = (sensors, model=None))]
    fn new(sensors: usize, model: Option<&[u8]>) -> PyResult<Self> {
        Ok(Self { running: Running::new(sensors, model)?, sensors, xl_end: [0; MAX_SENSORS] })
    }

    fn step(&mut self, py: Python<'_>, parts: Vec<Bound<'_, PyAny>>) -> PyResult<Output> {
        if parts.len() != self.sensors {
            return Err(refused(format!("{} sensors given, the pipeline has {}", parts.len(), self.sensors)));
        }
        let mut read = Vec::with_capacity(MAX_SENSORS);
        for (sensor, part) in parts.iter().enumerate() {
            let named = |error: String| refused(format!("sensor {sensor}: {error}"));
            // What Python says of it names no sensor, in many lines.
            let part = part.extract().map_err(|_| named(PART.to_owned()))?;
            let (piezo, xl, end) = match &part {
                Part::Counted((piezo, xl, end)) => (piezo, xl, Some(*end)),
                Part::Continuous((piezo, xl)) => (piezo, xl, None),
            };
            let piezo = piezo.as_ref().map(scan).transpose().map_err(named)?;
            let xl = xl.as_ref().map(samples).transpose().map_err(named)?;
            let next = self.xl_end[sensor].wrapping_add(xl.as_ref().map_or(0, |xl| xl.len() as u32));
            read.push((piezo, xl, end.unwrap_or(next)));
        }
        let inputs: Vec<SensorInput<'_>> = read
            .iter()
            .map(|(piezo, xl, xl_end)| SensorInput {
                piezo: piezo.as_ref(),
                xl: xl.as_deref(),
                xl_end: *xl_end,
            })
            .collect();
        inputs.iter().zip(&mut self.xl_end).for_each(|(input, xl_end)| *xl_end = input.xl_end);
        Output::new(py, &self.running.step(&inputs))
    }
}

/// 32 × 32 counts.
fn scan(array: &PyReadonlyArray2<'_, u16>) -> Result<PiezoFrame, String> {
    if array.shape() != [TAXEL_ROWS, TAXEL_COLS] {
        return Err(format!("piezo is {:?}, must be [{TAXEL_ROWS}, {TAXEL_COLS}]", array.shape()));
    }
    let mut counts = array.as_array().iter().copied().collect::<Vec<u16>>().into_iter();
    let counts = std::array::from_fn(|_| counts.next().unwrap_or_default());
    PiezoFrame::from_counts(counts).map_err(|error| format!("piezo: {error}"))
}

/// n × 3 samples.
fn samples(array: &PyReadonlyArray2<'_, i16>) -> Result<Vec<XlSample>, String> {
    if array.shape()[1] != XL_AXES {
        return Err(format!("xl is {:?}, must be [n, {XL_AXES}]", array.shape()));
    }
    let rows = array.as_array();
    Ok(rows.rows().into_iter().map(|row| std::array::from_fn(|axis| row[axis])).collect())
}

/// The contact on one pad.
#[pyclass(module = "slipsense", frozen, get_all)]
#[derive(Clone)]
pub struct Contact {
    health: u8,
    sum: u32,
    area: u16,
    centroid_row: f64,
    centroid_col: f64,
    axis_deg: i8,
    elongation: f64,
}

/// The contact on each pad of a message.
pub(crate) fn contacts(message: &SlipMessage) -> Vec<Contact> {
    let contacts = message.contact.iter().take(message.sensors.into());
    let contacts = contacts.map(|contact| Contact {
        health: contact.health,
        sum: contact.sum,
        area: contact.area,
        centroid_row: contact.centroid_row.to_f64(),
        centroid_col: contact.centroid_col.to_f64(),
        axis_deg: contact.axis_deg,
        elongation: contact.elongation.to_f64(),
    });
    contacts.collect()
}

/// The result of one frame.
#[pyclass(module = "slipsense", frozen, get_all)]
pub struct Output {
    class_index: u8,
    slip: bool,
    may_begin: bool,
    /// Bits: why not to believe `slip`, what makes it worse.
    invalid: u8,
    degraded: u8,
    logits_q10: Py<PyArray1<i32>>,
    /// The detector's log-odds of slip; none where no pad is touched.
    log_odds_q10: Option<i32>,
    contact: Vec<Contact>,
    logmel_std: Py<PyArray2<f32>>,
}

impl Output {
    fn new(py: Python<'_>, output: &slipsense::pipeline::Output) -> PyResult<Self> {
        let mel: Vec<Vec<f32>> =
            output.log_mel.iter().take(output.sensors).map(|mel| logmel_std(mel).to_vec()).collect();
        Ok(Self {
            class_index: output.class as u8,
            slip: output.slip,
            may_begin: output.may_begin,
            invalid: output.invalid,
            degraded: output.degraded,
            logits_q10: output.logits.map(Q::to_bits).to_vec().into_pyarray(py).unbind(),
            log_odds_q10: output.log_odds.map(Q::to_bits),
            contact: contacts(&output.slip_message(FrameStamp::default(), &Origin::default())),
            logmel_std: PyArray2::from_vec2(py, &mel).map_err(refused)?.unbind(),
        })
    }
}

#[pymethods]
impl Output {
    fn __repr__(&self) -> String {
        let Self { class_index, slip, invalid, .. } = self;
        format!("Output(class_index={class_index}, slip={slip}, invalid={invalid})")
    }
}
