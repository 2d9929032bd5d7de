//! `float`: the network before quantization, run by tract on the features of the integer front end, so that
//! the difference to `network` is the quantizer's alone.

use std::path::Path;

use anyhow::{Context, Result};
use slipsense::features::XlFrontEnd;
use slipsense::net::SensorFeatures;
use slipsense_model::tract::{Graphs, TractNetwork};
use slipsense_model::weights::Weights;

use crate::detector::{Detector, NEVER, Prediction, touched};

/// Slip where its logit is above the one of contact without slip, on a touched pad; nat, threshold 0.
pub(super) fn float(weights: Option<&Path>) -> Result<Detector<'static>> {
    let path = weights.context("float needs the float weights, a .safetensors file")?;
    let graphs = Graphs::new(&Weights::read(path)?).with_context(|| path.display().to_string())?;
    let mut stream: Option<(TractNetwork, Vec<XlFrontEnd>)> = None;
    Ok(Box::new(move |episode| {
        let sensors = episode.sensors;
        let (network, front_ends) = match stream.take().filter(|(_, kept)| kept.len() == sensors) {
            Some(kept) => stream.insert(kept),
            None => {
                let network = TractNetwork::new(&graphs, sensors)?;
                stream.insert((network, vec![XlFrontEnd::new(); sensors]))
            }
        };
        let (mut score, mut fallback) = (Vec::new(), Vec::new());
        for frame in 0..episode.frames() {
            let seen = front_ends.iter_mut().enumerate().map(|(sensor, front_end)| {
                front_end.push(episode.xl_batch(frame, sensor));
                let xl = front_end.log_mel().features();
                SensorFeatures { piezo: Some(episode.piezo(frame, sensor)), xl: Some(xl) }
            });
            let [_, no_slip, slip, _] = network.step(&seen.collect::<Vec<_>>())?;
            let touched = touched(episode, frame);
            score.push(if touched { slip - no_slip } else { NEVER });
            fallback.push(touched.into());
        }
        Ok(Prediction::new(score, 0.0, fallback))
    }))
}
