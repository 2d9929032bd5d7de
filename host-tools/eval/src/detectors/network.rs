//! `network`: the firmware's pipeline, bit for bit, by its classes.

use anyhow::{Context, Result};
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{Output, Pipeline};
use slipsense::sensor::SensorInput;
use slipsense_recording::Episode;

use super::{Detector, Modality, NETWORK, NEVER, Verdict};

/// The pipeline as a module runs it that is never switched off: its state goes on from episode to episode.
/// Another number of sensors starts anew, which a module in use cannot do.
pub struct PipelineStream<'m> {
    model: Model<'m>,
    dead: Option<Modality>,
    pipeline: Option<Box<Pipeline<'m>>>,
}

impl<'m> PipelineStream<'m> {
    /// Before the first frame.
    pub const fn new(model: Model<'m>) -> Self {
        Self::with_dead(model, None)
    }

    /// One whose sensors never deliver this modality.
    pub const fn with_dead(model: Model<'m>, dead: Option<Modality>) -> Self {
        Self { model, dead, pipeline: None }
    }

    /// Run the frames of the next episode; `each` gets the output of every frame in order. Is the state
    /// that of the frames before, and not a new one?
    pub fn run(&mut self, episode: &Episode, mut each: impl FnMut(&Output)) -> Result<bool> {
        let sensors = episode.sensors;
        let kept = self.pipeline.take().filter(|pipeline| pipeline.sensors() == sensors);
        let goes_on = kept.is_some();
        let pipeline = match kept {
            Some(pipeline) => self.pipeline.insert(pipeline),
            None => self.pipeline.insert(Box::new(Pipeline::new(self.model, sensors)?)),
        };
        for frame in 0..episode.frames() {
            let inputs: [SensorInput<'_>; MAX_SENSORS] = std::array::from_fn(|s| match s < sensors {
                true => SensorInput {
                    piezo: (self.dead != Some(Modality::Piezo)).then(|| episode.piezo(frame, s)),
                    xl: (self.dead != Some(Modality::Xl)).then(|| episode.xl_batch(frame, s)),
                    xl_end: episode.xl_end(frame, s),
                },
                false => SensorInput::default(),
            });
            each(&pipeline.step(&inputs[..sensors]));
        }
        Ok(goes_on)
    }

    /// Forget everything.
    pub fn reset(&mut self) {
        self.pipeline = None;
    }
}

pub(super) struct Network<'m>(PipelineStream<'m>);

impl<'m> Network<'m> {
    pub(super) fn new(model: &'m [u8], dead: Option<Modality>) -> Result<Self> {
        Ok(Self(PipelineStream::with_dead(Model::parse(model).context("model")?, dead)))
    }
}

/// A margin in nat; an untouched pad does not slip. A difference below 2^14 nat is exact in `f32`, and a
/// larger one keeps its sign.
pub(super) fn score(margin: Option<Logit>) -> f32 {
    margin.map_or(NEVER, |margin| margin.to_f64() as f32)
}

impl Detector for Network<'_> {
    fn name(&self) -> &'static str {
        NETWORK
    }

    /// The pipeline's rule as a score: on a touched pad, slip is where its logit is above the other's.
    /// Nat, threshold 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let mut verdict = Verdict::default();
        self.0.run(episode, |output| {
            verdict.class.push(output.class as u8);
            verdict.score.push(score(output.margin));
            verdict.fallback.push(output.margin.is_some().into());
        })?;
        Ok(verdict)
    }

    fn reset(&mut self) {
        self.0.reset();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_score_keeps_the_sign_of_the_smallest_and_the_largest_margin() {
        let of_bits = |bits| score(Some(Logit::from_bits(bits)));
        assert_eq!(of_bits(1), 1.0 / 1024.0);
        assert_eq!(of_bits(0), 0.0);
        assert!(of_bits(i32::MIN).is_finite() && of_bits(i32::MIN) > NEVER);
        assert!(of_bits(i32::MAX) > 0.0);
        assert_eq!(score(None), NEVER);
    }
}
