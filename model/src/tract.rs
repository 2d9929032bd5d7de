//! The float network run by tract: the same weights in another library's graphs, so that a mistake in how this
//! project computes a layer shows as a difference.
//!
//! tract computes every layer ([`graphs`]); here is only what is remembered between frames. The caches of keys
//! and values are inputs and outputs of a graph, handed on from frame to frame.

mod graphs;

use std::collections::VecDeque;

use anyhow::{Context, Result, ensure};
use slipsense::features::piezo::PiezoFrontEnd;
use slipsense::net::format::Dims;
use slipsense::params::{CLASSES, MEL_BINS, PIEZO_CHANNELS, TAXEL_COLS, TAXEL_ROWS, TAXELS};
use tract_core::prelude::{IntoTValue, TValue, Tensor, TypedSimpleState, tvec};

use crate::piezo::{self, PIEZO_INPUT_SCALE};
use crate::reference::{SensorFrame, keep_max, log_mel_real};

pub use graphs::Graphs;

/// Added to the score of a cache slot that no frame has filled yet: its weight is then 0 in single precision.
const UNFILLED: f32 = -10_000.0;

/// A network on tract and what it remembers; equals [`Reference`](crate::reference::Reference) but for the
/// order of additions.
pub struct TractNetwork {
    dims: Dims,
    piezo: TypedSimpleState,
    xl: TypedSimpleState,
    fuse: TypedSimpleState,
    /// Per sensor what the network sees of the pad, by the microcontroller's own kernel.
    pads: Vec<PiezoFrontEnd>,
    /// Per sensor the last `xl_kernel` log-mel frames, oldest first.
    heard: Vec<VecDeque<[f32; MEL_BINS]>>,
    /// Frames seen, up to the window.
    filled: usize,
    /// What is added to the scores of each lag, `[1, window]`.
    mask: TValue,
    /// Keys and values of the three blocks, newest frame first, `[window, width]` each.
    caches: Vec<TValue>,
}

impl TractNetwork {
    /// Before the first frame, for any number of sensors. Graphs are compiled once and serve any number of
    /// networks.
    pub fn new(graphs: &Graphs, sensors: usize) -> Result<Self> {
        let dims = graphs.dims;
        let silence = VecDeque::from(vec![[0.0; MEL_BINS]; dims.xl_kernel]);
        let caches = Graphs::BLOCKS.iter().flat_map(|block| [block.width(&dims); 2]);
        let caches = caches.map(|width| zeros(&[dims.window, width])).collect::<Result<_>>()?;
        Ok(Self {
            dims,
            piezo: graphs.piezo.spawn()?,
            xl: graphs.xl.spawn()?,
            fuse: graphs.fuse.spawn()?,
            pads: vec![PiezoFrontEnd::new(); sensors],
            heard: vec![silence; sensors],
            filled: 0,
            mask: zeros(&[1, dims.window])?,
            caches,
        })
    }

    /// One frame to three logits, nat. `sensors`: as many as the network was made for.
    pub fn step(&mut self, sensors: &[SensorFrame<'_>]) -> Result<[f32; CLASSES]> {
        let expected = self.heard.len();
        ensure!(sensors.len() == expected, "{} sensors given, {expected} expected", sensors.len());
        let (mut piezo, mut xl): (Option<Vec<f32>>, Option<Vec<f32>>) = (None, None);
        for (index, sensor) in sensors.iter().enumerate() {
            match sensor.piezo {
                Some(counts) => keep_max(&mut piezo, self.embed_piezo(index, counts)?),
                None => self.pads[index].reset(),
            }
            let mut frame = [0.0; MEL_BINS];
            for (real, &q13) in frame.iter_mut().zip(sensor.log_mel.into_iter().flatten()) {
                *real = log_mel_real(q13);
            }
            self.heard[index].pop_front();
            self.heard[index].push_back(frame);
            if sensor.log_mel.is_some() {
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
        let outputs = self.piezo.run(tvec![image])?;
        numbers(outputs.first())
    }

    fn embed_xl(&mut self, sensor: usize) -> Result<Vec<f32>> {
        let seen: Vec<f32> = self.heard[sensor].iter().flatten().copied().collect();
        let outputs = self.xl.run(tvec![tensor(&[1, seen.len()], &seen)?])?;
        numbers(outputs.first())
    }

    /// The embeddings of a frame, zeros where no sensor delivered, to its logits.
    fn fuse(&mut self, piezo: Option<Vec<f32>>, xl: Option<Vec<f32>>) -> Result<[f32; CLASSES]> {
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
        let mut outputs = self.fuse.run(inputs)?;
        self.caches.extend(outputs.drain(1..));
        let logits = numbers(outputs.first())?;
        logits.try_into().ok().context("the graph does not end in three logits")
    }
}

fn tensor(shape: &[usize], values: &[f32]) -> Result<TValue> {
    Ok(Tensor::from_shape(shape, values)?.into_tvalue())
}

fn zeros(shape: &[usize]) -> Result<TValue> {
    Ok(Tensor::zero::<f32>(shape)?.into_tvalue())
}

fn numbers(output: Option<&TValue>) -> Result<Vec<f32>> {
    let output = output.context("the graph has no output")?;
    Ok(output.try_as_plain_ram()?.as_slice::<f32>()?.to_vec())
}
