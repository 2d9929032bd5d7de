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

/// Number and time of a frame's tick. A replayed episode starts at time 0, with frame 0.
///
/// # Panics
/// Beyond frame 2^32, after 207 days.
pub fn stamp(frame: usize) -> FrameStamp {
    let sequence = u32::try_from(frame).expect("an episode is shorter than 207 days");
    FrameStamp::of_recording(sequence)
}

/// Run an episode. `send` gets every CAN frame in the order of the bus with the time of its tick in microseconds, the
/// slip message first in each period, then the raw frames in the form `raw`; `progress` is called once per frame.
pub fn simulate(
    episode: &Episode,
    model: Model<'_>,
    raw: RawForm,
    mut send: impl FnMut(u64, &CanFrame) -> Result<()>,
    mut progress: impl FnMut(),
) -> Result<Simulation> {
    let (frames, sensors) = (episode.frames(), episode.sensors);
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
        let mut send = |frame: &CanFrame| {
            simulation.can_frames += 1;
            send(stamp.timestamp_us, frame)
        };
        // A replay waits for every decision, so none is late.
        send(&transmitter.slip(&output.slip_message(stamp, &Origin::default())))?;
        for (sensor, &input) in inputs.iter().enumerate() {
            let message = output.raw_frame(stamp, sensor, input);
            transmitter.raw_as(raw, &message, &mut buffer).try_for_each(|frame| send(&frame))?;
        }
        progress();
    }
    Ok(simulation)
}

impl Simulation {
    /// Frames through the pipeline per second of its own time.
    pub fn frames_per_s(&self) -> f64 {
        self.predictions.frames() as f64 / self.step_time.as_secs_f64().max(1e-9)
    }
}
