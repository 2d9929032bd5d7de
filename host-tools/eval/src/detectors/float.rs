//! `float`: the network before quantization, run by tract on the features of the integer front end, so that
//! the difference to `network` is the quantizer's alone.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::features::XlFrontEnd;
use slipsense_model::tract::{Graphs, SensorFrame, TractNetwork};
use slipsense_model::weights::Weights;
use slipsense_recording::Episode;

use super::{Detector, FLOAT, NEVER, Verdict, touched};

pub(super) struct Float {
    graphs: Graphs,
    stream: Option<(TractNetwork, Vec<XlFrontEnd>)>,
}

impl Float {
    pub(super) fn new(weights: Option<&Path>) -> Result<Self> {
        let path =
            weights.with_context(|| format!("{FLOAT} needs the float weights, a .safetensors file"))?;
        let graphs = Graphs::new(&Weights::read(path)?);
        Ok(Self { graphs: graphs.with_context(|| path.display().to_string())?, stream: None })
    }
}

impl Detector for Float {
    fn name(&self) -> &'static str {
        FLOAT
    }

    /// Slip where its logit is above the one of contact without slip, on a touched pad; nat, threshold 0.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let sensors = episode.sensors;
        let kept = self.stream.take().filter(|(_, front_ends)| front_ends.len() == sensors);
        let (network, front_ends) = match kept {
            Some(kept) => self.stream.insert(kept),
            None => {
                let network = TractNetwork::new(&self.graphs, sensors)?;
                self.stream.insert((network, vec![XlFrontEnd::new(); sensors]))
            }
        };
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
            let [_, no_slip, slip] = network.step(&seen)?;
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
