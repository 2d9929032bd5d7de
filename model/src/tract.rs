//! The float network frame by frame, run by tract: the quantizer measures ranges on it, the integer network is
//! compared with it, and the training network must equal it.
//!
//! tract computes every layer ([`graphs`]); this file keeps the state between frames. The caches of keys and values
//! are inputs and outputs of a graph, handed on from frame to frame.

mod graphs;

use std::collections::VecDeque;

use anyhow::{Context, Result, ensure};
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::net::SensorFeatures;
use slipsense::net::format::Dims;
use slipsense::params::{OUTPUTS, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS, XL_FEATURES};
use tract_core::prelude::{IntoTValue, TValue, TVec, Tensor, TypedSimpleState, tvec};

use crate::piezo::{self, PIEZO_INPUT_SCALE};
use crate::trace::Trace;

use graphs::Compiled;
pub use graphs::Graphs;

/// Added to the score of a cache slot that no frame has filled yet: its weight is then 0 in single precision.
const UNFILLED: f32 = -10_000.0;

/// Q2.13 to real.
pub fn xl_real(q13: i16) -> f32 {
    f32::from(q13) / (1 << slipsense::features::STANDARDISED_FRAC_BITS) as f32
}

/// A network on tract and its state.
pub struct TractNetwork {
    dims: Dims,
    piezo: Running,
    xl: Running,
    fuse: Running,
    /// Per sensor what the network sees of the pad, by the microcontroller's own kernel.
    pads: Vec<PiezoFrontEnd>,
    /// Per sensor the last `xl_kernel` frames of the accelerometer, oldest first.
    xl_frames: Vec<VecDeque<[f32; XL_FEATURES]>>,
    /// Frames seen, up to the window.
    filled: usize,
    /// What is added to the scores of each lag, `[1, window]`.
    mask: TValue,
    /// Keys and values of the three blocks, newest frame first, `[window, width]` each.
    caches: Vec<TValue>,
    /// All activations since it was cleared, in the order of the integer network's; filled by
    /// [traced](Graphs::traced) graphs only.
    pub trace: Trace,
}

/// A graph with its state, and the activations that it returns behind its outputs.
struct Running {
    state: TypedSimpleState,
    traced: Vec<&'static str>,
}

impl Running {
    fn new(graph: &Compiled) -> Result<Self> {
        Ok(Self { state: graph.model.spawn()?, traced: graph.traced.clone() })
    }

    /// Record the traced activations, and return the other outputs.
    fn run(&mut self, inputs: TVec<TValue>, trace: &mut Trace) -> Result<TVec<TValue>> {
        let mut outputs = self.state.run(inputs)?;
        let traced = outputs.drain(outputs.len() - self.traced.len()..);
        for (activation, values) in self.traced.iter().zip(traced) {
            trace.record(activation, numbers(&values)?);
        }
        Ok(outputs)
    }
}

impl TractNetwork {
    /// Before the first frame, for any number of sensors. Graphs serve any number of networks.
    pub fn new(graphs: &Graphs, sensors: usize) -> Result<Self> {
        let dims = graphs.dims;
        let silence = VecDeque::from(vec![[0.0; XL_FEATURES]; dims.xl_kernel]);
        let widths = [dims.embed, dims.embed, dims.fused()].into_iter().flat_map(|width| [width; 2]);
        let caches = widths.map(|width| zeros(&[dims.window, width])).collect::<Result<_>>()?;
        Ok(Self {
            dims,
            piezo: Running::new(&graphs.piezo)?,
            xl: Running::new(&graphs.xl)?,
            fuse: Running::new(&graphs.fuse)?,
            pads: vec![PiezoFrontEnd::new(); sensors],
            xl_frames: vec![silence; sensors],
            filled: 0,
            mask: zeros(&[1, dims.window])?,
            caches,
            trace: Trace::default(),
        })
    }

    /// One frame to the network's outputs, nat. `sensors`: as many as the network was made for.
    pub fn step(&mut self, sensors: &[SensorFeatures<'_>]) -> Result<[f32; OUTPUTS]> {
        let expected = self.xl_frames.len();
        ensure!(sensors.len() == expected, "{} sensors given, {expected} expected", sensors.len());
        let (mut piezo, mut xl): (Option<Vec<f32>>, Option<Vec<f32>>) = (None, None);
        for (index, sensor) in sensors.iter().enumerate() {
            match sensor.piezo {
                Some(scan) => keep_max(&mut piezo, self.embed_piezo(index, scan.counts())?),
                None => self.pads[index].reset(),
            }
            let frame = sensor.xl.map_or([0.0; XL_FEATURES], |xl| xl.map(xl_real));
            self.xl_frames[index].pop_front();
            self.xl_frames[index].push_back(frame);
            if sensor.xl.is_some() {
                keep_max(&mut xl, self.embed_xl(index)?);
            }
        }
        self.fuse(piezo, xl)
    }

    fn embed_piezo(&mut self, sensor: usize, counts: &[u16; TAXELS]) -> Result<Vec<f32>> {
        let mut planes = vec![0.0; piezo::IMAGE];
        let (count_plane, change_plane) = planes.split_at_mut(TAXELS);
        self.pads[sensor].push(counts, |index, [count, change]| {
            count_plane[index] = f32::from(count) * PIEZO_INPUT_SCALE;
            change_plane[index] = f32::from(change) * PIEZO_INPUT_SCALE;
        });
        let image = tensor(&[1, PIEZO_CHANNELS, TAXEL_ROWS, TAXEL_COLS], &planes)?;
        numbers(&self.piezo.run(tvec![image], &mut self.trace)?[0])
    }

    fn embed_xl(&mut self, sensor: usize) -> Result<Vec<f32>> {
        let seen: Vec<f32> = self.xl_frames[sensor].iter().flatten().copied().collect();
        let frames = tensor(&[1, seen.len()], &seen)?;
        numbers(&self.xl.run(tvec![frames], &mut self.trace)?[0])
    }

    /// The embeddings of a frame, zeros where no sensor delivered, to its outputs.
    fn fuse(&mut self, piezo: Option<Vec<f32>>, xl: Option<Vec<f32>>) -> Result<[f32; OUTPUTS]> {
        let (embed, window) = (self.dims.embed, self.dims.window);
        if self.filled < window {
            self.filled += 1;
            let mask: Vec<f32> =
                (0..window).map(|lag| if lag < self.filled { 0.0 } else { UNFILLED }).collect();
            self.mask = tensor(&[1, window], &mask)?;
        }
        let mut inputs = tvec![];
        for embedding in [piezo, xl] {
            inputs.push(tensor(&[1, embed], &embedding.unwrap_or_else(|| vec![0.0; embed]))?);
        }
        inputs.push(self.mask.clone());
        inputs.extend(self.caches.drain(..));
        let mut outputs = self.fuse.run(inputs, &mut self.trace)?;
        self.caches.extend(outputs.drain(1..));
        let logits = numbers(&outputs[0])?;
        logits.try_into().ok().context("the graph does not end in as many outputs as the network has")
    }
}

/// Elementwise maximum over the sensors.
fn keep_max(best: &mut Option<Vec<f32>>, new: Vec<f32>) {
    match best {
        None => *best = Some(new),
        Some(best) => best.iter_mut().zip(new).for_each(|(best, new)| *best = best.max(new)),
    }
}

fn tensor(shape: &[usize], values: &[f32]) -> Result<TValue> {
    Ok(Tensor::from_shape(shape, values)?.into_tvalue())
}

fn zeros(shape: &[usize]) -> Result<TValue> {
    Ok(Tensor::zero::<f32>(shape)?.into_tvalue())
}

fn numbers(output: &TValue) -> Result<Vec<f32>> {
    Ok(output.try_as_plain_ram()?.as_slice::<f32>()?.to_vec())
}
