//! An episode through the pipeline, frame by frame, as a module on a gripper sees it.

use std::time::{Duration, Instant};

use anyhow::Result;
use slipsense::net::Model;
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::wire::{CanFrame, NodeId, Origin, RawBuffer, RawForm, Transmitter};
use slipsense_recording::{Episode, Predictions};

/// The pipeline's output for an episode.
#[derive(Clone, Debug, Default)]
pub struct Simulation {
    pub predictions: Predictions,
    /// Sum of each pad, counts, `[frame * sensors + sensor]`.
    pub pressure: Vec<u32>,
    /// Health bits (`slipsense::health`) of each sensor, `[frame * sensors + sensor]`.
    pub health: Vec<u8>,
    pub can_frames: u64,
    /// Time spent in the pipeline alone, on one core.
    pub step_time: Duration,
}

/// Number and time of a frame's tick: frame 0 is at time 0. Panics beyond frame 2^32, after 207 days.
pub fn stamp(frame: usize) -> FrameStamp {
    let sequence = u32::try_from(frame).expect("an episode is shorter than 207 days");
    FrameStamp::of_recording(sequence)
}

/// Run the first `frames` frames of an episode. `each` gets the stamp of a frame and its CAN frames in the order of the
/// bus: the slip message first, then the raw frames in the form `raw`.
pub fn simulate(
    episode: &Episode,
    frames: usize,
    model: Model<'_>,
    raw: RawForm,
    mut each: impl FnMut(FrameStamp, &[CanFrame]) -> Result<()>,
) -> Result<Simulation> {
    let sensors = episode.sensors;
    let mut pipeline = Pipeline::new(model, sensors)?;
    let (mut transmitter, mut buffer) = (Transmitter::new(NodeId::DEFAULT), RawBuffer::new());
    let mut simulation = Simulation { predictions: Predictions::new(sensors), ..Simulation::default() };
    for frame in 0..frames {
        let inputs = episode.inputs(frame);
        let inputs = &inputs[..sensors];
        let start = Instant::now();
        let output = pipeline.step(inputs);
        simulation.step_time += start.elapsed();
        simulation.predictions.push(&output, episode.meta.xl_lsb_g);
        simulation.pressure.extend(output.contact[..sensors].iter().map(|contact| contact.sum));
        simulation.health.extend(output.health[..sensors].iter().map(|health| health.0));

        let stamp = stamp(frame);
        // A replay waits for every decision, so none is late.
        let mut can = vec![transmitter.slip(&output.slip_message(stamp, &Origin::default()))];
        for (sensor, &input) in inputs.iter().enumerate() {
            let message = output.raw_frame(stamp, sensor, input);
            can.extend(transmitter.raw_as(raw, &message, &mut buffer));
        }
        simulation.can_frames += can.len() as u64;
        each(stamp, &can)?;
    }
    Ok(simulation)
}
