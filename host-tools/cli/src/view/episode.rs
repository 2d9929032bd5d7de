//! Frames of an episode, through the pipeline.

use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Pipeline, SensorCountError};
use slipsense::sensor::SensorInput;
use slipsense_recording::Episode;

use super::record::{Record, SensorRecord};
use super::store::Store;

/// Label of a frame that slips.
const SLIPS: u8 = 2;

/// Put all frames into the store, as fast as they come.
pub fn run(episode: &Episode, model: Model<'_>, store: &Store) -> Result<(), SensorCountError> {
    let sensors = episode.sensors.min(MAX_SENSORS);
    let mut pipeline = Pipeline::new(model, sensors)?;
    for frame in 0..episode.frames() {
        let inputs: Vec<SensorInput<'_>> = (0..sensors)
            .map(|sensor| SensorInput {
                piezo: Some(episode.piezo(frame, sensor)),
                xl: Some(episode.xl_batch(frame, sensor)),
                xl_end: episode.xl_end(frame, sensor),
            })
            .collect();
        let output = pipeline.step(&inputs);
        let sensor = |sensor: usize| SensorRecord {
            piezo: Some(episode.piezo(frame, sensor).clone()),
            log_mel: Some(output.log_mel[sensor]),
        };
        store.push(&Record {
            slip: output.slip_message(FrameStamp::of_recording(frame as u32), 0),
            lost: 0,
            truth: episode.label.as_ref().map(|label| label[frame] == SLIPS),
            sensors: (0..sensors).map(sensor).collect(),
        });
    }
    Ok(())
}
