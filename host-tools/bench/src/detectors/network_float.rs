//! `network-float`: the network before quantization, on the features of the integer front end, so that the
//! difference to `network` is the quantizer's alone.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::features::XlFrontEnd;
use slipsense_episode::Episode;
use slipsense_model::reference::{Reference, SensorFrame};
use slipsense_model::weights::Weights;

use super::{Detector, NETWORK_FLOAT, NEVER, Verdict, touched};

pub(super) struct NetworkFloat {
    /// Leaked: one per process, and what runs on it borrows it for as long as it lives.
    weights: &'static Weights,
    stream: Option<(Reference<'static>, Vec<XlFrontEnd>)>,
}

impl NetworkFloat {
    pub(super) fn new(weights: Option<&Path>) -> Result<Self> {
        let path = weights
            .with_context(|| format!("{NETWORK_FLOAT} needs the float weights, a .safetensors file"))?;
        Ok(Self { weights: Box::leak(Box::new(Weights::read(path)?)), stream: None })
    }
}

impl Detector for NetworkFloat {
    fn name(&self) -> &'static str {
        NETWORK_FLOAT
    }

    /// Slip where its logit is above the one of contact without slip, on a touched pad; nat, threshold 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let sensors = episode.sensors;
        let kept = self.stream.take().filter(|(_, front_ends)| front_ends.len() == sensors);
        let fresh = || (Reference::new(self.weights, sensors), vec![XlFrontEnd::new(); sensors]);
        let (reference, front_ends) = self.stream.insert(kept.unwrap_or_else(fresh));
        let (mut score, mut fallback) = (Vec::new(), Vec::new());
        for frame in 0..episode.frames() {
            let heard: Vec<_> = front_ends
                .iter_mut()
                .enumerate()
                .map(|(sensor, front_end)| {
                    front_end.push(episode.xl_batch(frame, sensor));
                    front_end.log_mel().standardised
                })
                .collect();
            let seen: Vec<_> = heard
                .iter()
                .enumerate()
                .map(|(sensor, log_mel)| SensorFrame {
                    piezo: Some(episode.piezo(frame, sensor).counts()),
                    log_mel: Some(log_mel),
                })
                .collect();
            let [_, no_slip, slip] = reference.step(&seen);
            let touched = touched(episode, frame);
            score.push(if touched { slip - no_slip } else { NEVER });
            fallback.push(touched.into());
        }
        Ok(Verdict::new(score, 0.0, fallback))
    }

    fn reset(&mut self) {
        self.stream = None;
    }
}
