//! What answers to a frame: the pipeline, or, without a readable model, an invalid slip message.

use defmt::{Display2Format, error, info, warn};
use slipsense::board::Clock;
use slipsense::firmware::model;
use slipsense::firmware::shared::{FrameReceiver, Mutex, RawSender, SHARED, Uptime};
use slipsense::health::{self, CanState, SensorHealth, Status};
use slipsense::net::Model;
use slipsense::net::format::HASH_BYTES;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Pipeline, SensorCountError, State};
use slipsense::tasks::{Inference, Reference, Supervisor, Task};
use slipsense::wire::{INVALID_NO_MODEL, NodeId, Origin, SensorContact, SlipMessage, Transmitter};
use static_cell::StaticCell;

use crate::frame_source;
use crate::self_check::{self, BoardCheck};
use crate::watchdog::Watchdog;

type BoardInference = Inference<'static, Mutex, Uptime, (), &'static mut State>;
static INFERENCE: StaticCell<BoardInference> = StaticCell::new();
/// Frames in a row that leave no time for a check; after them one is made anyway, for which the next may be late.
const CHECK_ANYWAY: u32 = 25;

/// With a model or without.
pub enum Decider {
    Pipeline(&'static mut BoardInference, &'static mut BoardCheck),
    WithoutModel { sensors: usize },
}

impl Decider {
    /// Make the pipeline, or report why there is none. Apart: what this takes of the stack is given back.
    ///
    /// In two steps, one after the other, so that what parsing takes of the stack is gone when the pipeline is made.
    #[inline(never)]
    pub fn new(bytes: &'static [u8], raw: RawSender, sensors: usize, firmware: Reference) -> Self {
        match Model::parse(bytes) {
            Ok(model) => {
                let check = self_check::build(bytes, &model, firmware);
                Self::with(model, raw, sensors, check)
            }
            Err(error) => {
                error!("model: {}", Display2Format(&error));
                Self::WithoutModel { sensors }
            }
        }
    }

    /// On a state that is made where it stays, in AXI SRAM.
    #[inline(never)]
    fn with(
        model: Model<'static>,
        raw: RawSender,
        sensors: usize,
        check: Result<&'static mut BoardCheck, SensorCountError>,
    ) -> Self {
        let pipeline = Pipeline::with_state(model::first_state(), model, sensors);
        let (pipeline, check) = match pipeline.and_then(|pipeline| Ok((pipeline, check?))) {
            Ok(made) => made,
            Err(error) => {
                error!("pipeline: {}", Display2Format(&error));
                return Self::WithoutModel { sensors };
            }
        };
        let transmitter = Transmitter::new(NodeId::DEFAULT);
        let inference = Inference::new(pipeline, transmitter, Uptime, (), &SHARED, raw);
        Self::Pipeline(INFERENCE.init(inference), check)
    }

    /// Of the model that runs.
    pub fn model_hash(&self) -> Option<[u8; HASH_BYTES]> {
        match self {
            Self::Pipeline(inference, _) => Some(inference.pipeline.model().hash),
            Self::WithoutModel { .. } => None,
        }
    }

    /// Decide frames, check a piece of the node after each, for ever, and feed the watchdog while every task moves on.
    pub async fn run(&mut self, mut queue: FrameReceiver, mut watchdog: Watchdog) {
        let mut degraded = Transmitter::new(NodeId::DEFAULT);
        let mut supervisor = Supervisor::new(&Task::ALL);
        let mut frames_until_report = FRAME_RATE_HZ;
        let mut unchecked = 0;
        loop {
            match self {
                Self::Pipeline(inference, check) => {
                    inference.serve(&mut queue).await;
                    unchecked += 1;
                    if SHARED.has_time(Uptime.now_us()) || unchecked > CHECK_ANYWAY {
                        unchecked = 0;
                        let found = check.step();
                        SHARED.update_status(|status| status.self_checks = found);
                    }
                }
                &mut Self::WithoutModel { sensors } => {
                    let stamp = queue.receive().await.stamp;
                    queue.receive_done();
                    SHARED.progress.made(Task::Infer);
                    let config = SHARED.config();
                    let mut message = SlipMessage::default();
                    SHARED.update_status(|status| {
                        message = without_model(stamp, sensors, status, config.locked);
                        status.sensor_health = message.contact.map(|contact| SensorHealth(contact.health));
                    });
                    if let Some(node) = config.node {
                        degraded.set_node_id(node);
                        SHARED.send_slip(degraded.slip(&message));
                    } else {
                        SHARED.wake_transmission();
                    }
                }
            }
            // A task that stands still shows in the log of the restart that the watchdog makes.
            let _ = supervisor.look(&SHARED.progress, &mut watchdog);
            frames_until_report -= 1;
            if frames_until_report == 0 {
                frames_until_report = FRAME_RATE_HZ;
                self.report();
            }
        }
    }

    /// Into the log, once a second.
    fn report(&self) {
        let status = SHARED.status();
        info!(
            "late {=u32}, worst {=u32} us, dropped: frames {=u32}, raw messages {=u32}, slip messages {=u32}",
            status.late_frames,
            status.worst_frame_us,
            status.dropped_frames,
            status.dropped_raw,
            status.replaced_slips
        );
        let sensors = match self {
            Self::Pipeline(inference, _) => inference.pipeline.sensors(),
            &Self::WithoutModel { sensors } => {
                error!("no readable model: slip messages are invalid");
                sensors
            }
        };
        if status.can.state == CanState::BusOff {
            warn!("the node is off the bus, {=u32} times so far", status.bus_offs);
        }
        frame_source::log(sensors);
    }
}

/// What the node can say without a network: the time, and that nothing in it is a decision.
fn without_model(stamp: FrameStamp, sensors: usize, status: &Status, locked: bool) -> SlipMessage {
    let flagged = SensorContact {
        health: health::NO_MODEL | health::PIEZO_MISSING | health::XL_MISSING,
        ..SensorContact::default()
    };
    let mut contact = [SensorContact::default(); MAX_SENSORS];
    contact.iter_mut().take(sensors).for_each(|contact| *contact = flagged);
    let FrameStamp { sequence, timestamp_us } = stamp;
    // Nothing is decided, so none is late: those that acquisition dropped.
    let origin = Origin::new(status, status.dropped_frames, false, locked);
    SlipMessage { timestamp_us, sequence, invalid: INVALID_NO_MODEL, contact, ..origin.message(sensors, 0) }
}
