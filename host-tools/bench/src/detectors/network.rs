//! `network`: the firmware's pipeline, bit for bit.

use anyhow::{Context, Result};
use slipsense::net::Model;
use slipsense::params::{CLASSES, MAX_SENSORS};
use slipsense::pipeline::Pipeline;
use slipsense::sensor::SensorInput;
use slipsense_episode::Episode;

use super::{Detector, NETWORK, NEVER, Verdict, touched};

/// Units of a logit per nat.
const LOGIT_ONE: f64 = (1u32 << slipsense::net::network::LOGIT_FRAC_BITS) as f64;

pub(super) struct Network<'m> {
    model: Model<'m>,
    pipeline: Option<Box<Pipeline<'m>>>,
}

impl<'m> Network<'m> {
    pub(super) fn new(model: &'m [u8]) -> Result<Self> {
        Ok(Self { model: Model::parse(model).context("model")?, pipeline: None })
    }
}

/// The pipeline's rule as a score: on a touched pad, slip is where its logit is above the other's; an
/// untouched pad does not slip. Nat, threshold 0. A difference below 2^14 nat is exact in `f32`, and a
/// larger one keeps its sign.
fn score(touched: bool, [_, no_slip, slip]: [i32; CLASSES]) -> f32 {
    match touched {
        true => ((f64::from(slip) - f64::from(no_slip)) / LOGIT_ONE) as f32,
        false => NEVER,
    }
}

impl Detector for Network<'_> {
    fn name(&self) -> &'static str {
        NETWORK
    }

    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let sensors = episode.sensors;
        let kept = self.pipeline.take().filter(|pipeline| pipeline.sensors() == sensors);
        let pipeline = match kept {
            Some(pipeline) => self.pipeline.insert(pipeline),
            None => self.pipeline.insert(Box::new(Pipeline::new(self.model, sensors)?)),
        };
        let mut verdict = Verdict::default();
        for frame in 0..episode.frames() {
            let inputs: [SensorInput<'_>; MAX_SENSORS] = std::array::from_fn(|s| match s < sensors {
                true => {
                    SensorInput { piezo: Some(episode.piezo(frame, s)), xl: Some(episode.xl_batch(frame, s)) }
                }
                false => SensorInput::default(),
            });
            let output = pipeline.step(&inputs[..sensors]);
            let touched = touched(episode, frame);
            verdict.class.push(output.class as u8);
            verdict.score.push(score(touched, output.logits_q10));
            verdict.fallback.push(touched.into());
        }
        Ok(verdict)
    }

    fn reset(&mut self) {
        self.pipeline = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_score_keeps_the_sign_of_the_smallest_and_the_largest_difference() {
        assert_eq!(score(true, [9, 100, 101]), 1.0 / 1024.0);
        assert_eq!(score(true, [9, 101, 101]), 0.0);
        assert!(score(true, [0, i32::MIN, i32::MAX]).is_finite());
        assert!(score(true, [0, i32::MIN, i32::MIN + 1]) > 0.0);
        assert!(score(true, [0, i32::MAX, i32::MAX - 1]) < 0.0);
        assert_eq!(score(false, [0, 0, 9999]), NEVER);
    }
}
