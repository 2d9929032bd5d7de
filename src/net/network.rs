//! The streaming graph: embeddings, maximum over sensors, two cross-attentions, one over time, head.

use super::activations::Activations;
use super::attention::{KeyValueCache, attend};
use super::dense::dense;
use super::encoder::{Embedding, PiezoEncoder, XlHistory};
use super::model::Model;
use super::observer::Observer;
use crate::features::XlFeatures;
use crate::features::piezo::PiezoFrontEnd;
use crate::fixed::Logit;
use crate::fixed::saturate_i16;
use crate::params::limits::EMBED;
use crate::params::{MAX_SENSORS, OUTPUTS, XL_FEATURES};
use crate::sensor::PiezoFrame;

/// Width of the fused vector, at most.
const FUSED: usize = 2 * EMBED;
/// An embedding in words, and both of them.
const EMBED_WORDS: usize = EMBED / 2;
const FUSED_WORDS: usize = FUSED / 2;

/// The network's input of one sensor at one frame. `None` leaves the part out of the maximum.
#[derive(Clone, Copy, Debug, Default)]
pub struct SensorFeatures<'a> {
    /// The array scan.
    pub piezo: Option<&'a PiezoFrame>,
    /// Features of the accelerometer, Q2.13.
    pub xl: Option<XlFeatures>,
}

/// Everything that a network keeps from frame to frame, whatever the model. All of it starts as zeros.
#[derive(Clone, Debug)]
pub struct NetworkState {
    piezo: PiezoEncoder,
    xl: [XlHistory; MAX_SENSORS],
    piezo_seen: KeyValueCache<EMBED_WORDS>,
    xl_seen: KeyValueCache<EMBED_WORDS>,
    fused_seen: KeyValueCache<FUSED_WORDS>,
}

/// A model with its state.
#[derive(Clone, Debug)]
pub struct Network<'m> {
    model: Model<'m>,
    state: NetworkState,
    front_ends: [PiezoFrontEnd; MAX_SENSORS],
}

impl<'m> Network<'m> {
    /// Before the first frame.
    pub const fn new(model: Model<'m>) -> Self {
        Self { model, state: NetworkState::new(), front_ends: [const { PiezoFrontEnd::new() }; MAX_SENSORS] }
    }

    /// The model it runs.
    pub const fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// One frame of up to [`MAX_SENSORS`] sensors to the logits of the classes and the log-odds of slip, whose integers
    /// have 16 bits.
    pub fn step(&mut self, sensors: &[SensorFeatures<'_>]) -> [Logit; OUTPUTS] {
        self.step_observed(sensors, &mut ())
    }

    /// As [`step`](Self::step); `observer` gets every activation.
    pub fn step_observed(
        &mut self,
        sensors: &[SensorFeatures<'_>],
        observer: &mut impl Observer,
    ) -> [Logit; OUTPUTS] {
        self.state.step(&self.model, &mut self.front_ends, sensors, observer)
    }
}

impl NetworkState {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self {
            piezo: PiezoEncoder::new(),
            xl: [const { XlHistory::new() }; MAX_SENSORS],
            piezo_seen: KeyValueCache::new(),
            xl_seen: KeyValueCache::new(),
            fused_seen: KeyValueCache::new(),
        }
    }

    /// One frame, as [`Network::step_observed`], with a front end for each sensor. All frames must be of the same model.
    pub fn step(
        &mut self,
        model: &Model<'_>,
        front_ends: &mut [PiezoFrontEnd],
        sensors: &[SensorFeatures<'_>],
        observer: &mut impl Observer,
    ) -> [Logit; OUTPUTS] {
        let (piezo, xl) = self.embed(model, front_ends, sensors, observer);
        let fused = self.fuse(model, &piezo, &xl, observer);
        let (width, window) = (model.dims.fused().min(FUSED), model.dims.window);
        observer.record("fused", fused.values().get(..width).unwrap_or_default());
        self.fused_seen.push(&model.temporal, &fused, window, observer);
        let mut hidden = Activations::<FUSED_WORDS>::new();
        attend(&model.temporal, &fused, &self.fused_seen, hidden.values_mut(), observer);
        observer.record("hidden", hidden.values().get(..width).unwrap_or_default());
        let mut logits = [0; OUTPUTS];
        dense(&model.head, hidden.words(), &mut logits, saturate_i16);
        observer.record("logits", &logits);
        logits.map(|logit| Logit::from_bits(logit.into()))
    }

    /// The two embeddings of a frame: per modality the element-wise maximum over the sensors that
    /// delivered, zeros if none did.
    fn embed(
        &mut self,
        model: &Model<'_>,
        front_ends: &mut [PiezoFrontEnd],
        sensors: &[SensorFeatures<'_>],
        observer: &mut impl Observer,
    ) -> (Embedding, Embedding) {
        let mut piezo = None;
        let mut xl = None;
        for ((sensor, history), pad) in sensors.iter().zip(&mut self.xl).zip(front_ends) {
            match sensor.piezo {
                Some(frame) => keep_max(&mut piezo, self.piezo.embed(model, frame, pad, observer)),
                None => pad.reset(),
            }
            // A missed frame enters as zeros, the mean of a standardised one at the floor: the taps keep their distance in time.
            history.push(&sensor.xl.unwrap_or([0; XL_FEATURES]));
            if sensor.xl.is_some() {
                keep_max(&mut xl, history.embed(model, observer));
            }
        }
        (piezo.unwrap_or(Embedding::new()), xl.unwrap_or(Embedding::new()))
    }

    /// Both cross-attentions, side by side: piezo first.
    fn fuse(
        &mut self,
        model: &Model<'_>,
        piezo: &Embedding,
        xl: &Embedding,
        observer: &mut impl Observer,
    ) -> Activations<FUSED_WORDS> {
        let (embed, window) = (model.dims.embed.min(EMBED), model.dims.window);
        self.xl_seen.push(&model.cross_piezo, xl, window, observer);
        self.piezo_seen.push(&model.cross_xl, piezo, window, observer);
        let mut fused = Activations::new();
        if let Some((first, second)) = fused.values_mut().split_at_mut_checked(embed) {
            attend(&model.cross_piezo, piezo, &self.xl_seen, first, observer);
            attend(&model.cross_xl, xl, &self.piezo_seen, second, observer);
        }
        fused
    }
}

fn keep_max(best: &mut Option<Embedding>, new: Embedding) {
    match best {
        None => *best = Some(new),
        Some(best) => {
            for (best, &new) in best.values_mut().iter_mut().zip(new.values()) {
                *best = (*best).max(new);
            }
        }
    }
}
