//! Episode files, and whole episodes at once.

use std::path::PathBuf;

use numpy::{IntoPyArray, PyArray1, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use slipsense::params::{CLASSES, MEL_BINS, TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense_recording::film::PRESSURE_KPA;
use slipsense_recording::{Episode as Recording, Predictions};

use crate::pipeline::{Running, refused};

/// A stretch of sensor data.
#[pyclass(module = "slipsense", frozen)]
pub struct Episode(Recording);

#[pymethods]
impl Episode {
    #[staticmethod]
    fn read(path: PathBuf) -> PyResult<Self> {
        Recording::read(path).map(Self).map_err(refused)
    }

    #[staticmethod]
    #[pyo3(signature = (data, name="episode"))]
    fn from_bytes(data: &[u8], name: &str) -> PyResult<Self> {
        Recording::from_bytes(data, name).map(Self).map_err(refused)
    }

    fn write(&self, path: PathBuf) -> PyResult<()> {
        self.0.write(path).map_err(refused)
    }

    fn to_xarray<'py>(this: &Bound<'py, Self>) -> PyResult<Bound<'py, PyAny>> {
        this.py().import("slipsense._xarray")?.call_method1("dataset", (this,))
    }

    #[getter]
    fn frames(&self) -> usize {
        self.0.frames()
    }

    #[getter]
    fn sensors(&self) -> usize {
        self.0.sensors
    }

    /// JSON text.
    #[getter]
    fn meta(&self) -> String {
        self.0.meta.to_json()
    }

    #[getter]
    fn piezo<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let counts: Vec<u16> = self.0.piezo.iter().flat_map(|scan| scan.counts().iter().copied()).collect();
        let shape = [self.0.frames(), self.0.sensors, TAXEL_ROWS, TAXEL_COLS];
        Ok(counts.into_pyarray(py).reshape(shape)?.into_any())
    }

    #[getter]
    fn xl<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let samples: Vec<i16> = self.0.xl.iter().flatten().flatten().copied().collect();
        Ok(samples.into_pyarray(py).reshape([self.0.sensors, self.0.xl[0].len(), XL_AXES])?.into_any())
    }

    #[getter]
    fn xl_end<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let ends = self.0.xl_end.clone().into_pyarray(py);
        Ok(ends.reshape([self.0.frames(), self.0.sensors])?.into_any())
    }

    #[getter]
    fn label<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<u8>>> {
        self.0.label.as_ref().map(|label| label.clone().into_pyarray(py))
    }

    #[getter]
    fn slip_true<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        self.0.slip_true_mm_s.as_ref().map(|speed| speed.clone().into_pyarray(py))
    }

    #[getter]
    fn slip_fraction<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        self.0.slip_fraction.as_ref().map(|share| share.clone().into_pyarray(py))
    }

    #[getter]
    fn displacement_mm<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f32>>> {
        self.0.displacement_mm.as_ref().map(|mm| mm.clone().into_pyarray(py))
    }

    fn __repr__(&self) -> String {
        format!("Episode(frames={}, sensors={})", self.0.frames(), self.0.sensors)
    }
}

/// Pressure of each count, kPa.
#[pyfunction]
pub fn pressure_table_kpa(py: Python<'_>) -> Bound<'_, PyArray1<f32>> {
    PRESSURE_KPA.clone().into_pyarray(py)
}

/// All frames of an episode through the pipeline, without the interpreter in between.
#[pyfunction]
#[pyo3(signature = (episode, model=None))]
pub fn run<'py>(py: Python<'py>, episode: &Episode, model: Option<&[u8]>) -> PyResult<Bound<'py, PyDict>> {
    let (episode, sensors) = (&episode.0, episode.0.sensors);
    let mut pipeline = Running::new(sensors, model)?;
    let frames = episode.frames();
    let predictions = py.detach(|| {
        let mut predictions = Predictions::new(sensors);
        for frame in 0..frames {
            let output = pipeline.step(&episode.inputs(frame)[..sensors]);
            predictions.push(&output, episode.meta.xl_lsb_g);
        }
        predictions
    });
    let dict = PyDict::new(py);
    dict.set_item("class", predictions.class.into_pyarray(py))?;
    dict.set_item("logits", predictions.logits.concat().into_pyarray(py).reshape([frames, CLASSES])?)?;
    dict.set_item("log_odds", predictions.log_odds.into_pyarray(py))?;
    dict.set_item("may_begin", predictions.may_begin.into_pyarray(py))?;
    dict.set_item("slip", predictions.slip.into_pyarray(py))?;
    for (name, rows) in [("logmel", predictions.logmel), ("logmel_std", predictions.logmel_std)] {
        dict.set_item(name, rows.concat().into_pyarray(py).reshape([frames, sensors, MEL_BINS])?)?;
    }
    Ok(dict)
}
