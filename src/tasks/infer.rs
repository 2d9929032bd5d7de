//! From the frame queue to messages: one frame in, a slip message and raw messages out. Never waits for the bus.

use core::borrow::BorrowMut;

use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::zerocopy_channel::{Receiver, Sender};

use super::rate_control::RateControl;
use super::{RAW_MESSAGES, RuntimeConfig, Shared, Task};
use crate::board::{Clock, Observe, SensorFrame};
use crate::params::{FRAME_PERIOD_US, MAX_SENSORS};
use crate::pipeline::{Output, Pipeline, State};
use crate::sensor::SensorReadings;
use crate::settings::model_numbers;
use crate::wire::{DEGRADED_FROZEN, INVALID_OTHER_MODEL, Origin, RawForm, RawTransfer, Transmitter};

/// Everything between the frame queue and the messages that wait for the bus.
pub struct Inference<'m, M: RawMutex, C, O, S = State> {
    /// The signal path.
    pub pipeline: Pipeline<'m, S>,
    /// Makes CAN frames of messages.
    pub transmitter: Transmitter,
    /// The clock that stamped the ticks.
    pub clock: C,
    /// Whoever else wants to see the results.
    pub observer: O,
    shared: &'m Shared<M>,
    raw: Sender<'m, M, RawTransfer>,
    /// How much of the compressed raw messages the bus takes.
    rate: RateControl,
}

impl<'m, M: RawMutex, C: Clock, O: Observe, S: BorrowMut<State>> Inference<'m, M, C, O, S> {
    /// Before the first frame. `raw` is one end of a [`RawQueue`](super::RawQueue) with [`RAW_MESSAGES`] buffers.
    pub const fn new(
        pipeline: Pipeline<'m, S>,
        transmitter: Transmitter,
        clock: C,
        observer: O,
        shared: &'m Shared<M>,
        raw: Sender<'m, M, RawTransfer>,
    ) -> Self {
        Self { pipeline, transmitter, clock, observer, shared, raw, rate: RateControl::ALL }
    }

    /// Serve the queue for ever.
    pub async fn run(&mut self, mut queue: Receiver<'_, M, SensorFrame>) -> ! {
        loop {
            self.serve(&mut queue).await;
        }
    }

    /// Wait for one frame, decide, leave the slip message and then the raw messages to transmission.
    pub async fn serve(&mut self, queue: &mut Receiver<'_, M, SensorFrame>) {
        let frame = queue.receive().await;
        self.shared.progress.made(Task::Infer);
        let stamp = frame.stamp;
        let config = self.shared.config();
        self.pipeline.configure(config.point, &config.masks, config.mountings);
        if let Some(node) = config.node {
            self.transmitter.set_node_id(node);
        }
        self.observer.step_begins(stamp);
        let output = self.pipeline.step_readings(&mut frame.parts);
        self.observer.step_ends(stamp, &output);
        self.decided(frame, &output, &config);
        if config.node.is_some() {
            self.offer_raw(frame, &output, &config);
        }
        self.observer.frame_done(stamp);
        queue.receive_done();
        // A queue that is never empty must not keep the other tasks of this executor from running.
        yield_now().await;
    }

    fn decided(&mut self, frame: &SensorFrame, output: &Output, config: &RuntimeConfig) {
        let age_us = self.clock.now_us().saturating_sub(frame.stamp.timestamp_us);
        let late = age_us > FRAME_PERIOD_US;
        self.shared.decided(frame.stamp.timestamp_us);
        let mut origin = Origin::default();
        self.shared.update_status(|status| {
            status.decided_frames = status.decided_frames.wrapping_add(1);
            status.worst_frame_us = status.worst_frame_us.max(u32::try_from(age_us).unwrap_or(u32::MAX));
            if late {
                status.late_frames = status.late_frames.saturating_add(1);
            }
            (status.sensors, status.sensor_health) = (output.sensors, output.health);
            status.frozen = output.degraded & DEGRADED_FROZEN != 0;
            let late_frames = frame.dropped_frames.wrapping_add(status.late_frames);
            origin = Origin::new(status, late_frames, late, config.locked);
        });
        if config.expected_model.is_some_and(|model| model != model_numbers(&self.pipeline.model().hash)) {
            origin.invalid |= INVALID_OTHER_MODEL;
        }
        if config.node.is_some() {
            self.shared.send_slip(self.transmitter.slip(&output.slip_message(frame.stamp, &origin)));
        } else {
            self.shared.wake_transmission();
        }
    }

    /// Queue the raw messages for which there is room, in sensor order. Where there is not room for all, or not for all
    /// of each, the sensors take turns, so that none is always the one left out.
    fn offer_raw(&mut self, frame: &SensorFrame, output: &Output, config: &RuntimeConfig) {
        let stamp = frame.stamp;
        let every = u32::from(config.raw_every);
        if stamp.sequence.checked_rem(every) != Some(0) {
            return;
        }
        let inputs = frame.parts.each_ref().map(SensorReadings::input);
        let turns = stamp.sequence.checked_div(every).unwrap_or(0);
        let first = turns.checked_rem(output.sensors as u32).unwrap_or(0) as usize;
        self.rate.frame(self.raw.len(), output.sensors);
        let mut room = RAW_MESSAGES.saturating_sub(self.raw.len());
        let mut planned = [(RawForm::Plain, false); MAX_SENSORS];
        for turn in 0..output.sensors {
            let sensor =
                if first + turn < output.sensors { first + turn } else { first + turn - output.sensors };
            let delivered =
                inputs.get(sensor).is_some_and(|input| input.piezo.is_some() || input.xl.is_some());
            let Some((form, fits)) = planned.get_mut(sensor) else { continue };
            if config.compress_raw {
                *form = RawForm::Compressed(self.rate.detail(turn, output.sensors));
            }
            if delivered && room > 0 {
                *fits = true;
                room -= 1;
            }
        }
        let mut dropped: u32 = 0;
        let sensors = inputs.iter().zip(planned).take(output.sensors).enumerate();
        for (sensor, (&input, (form, fits))) in sensors {
            let raw = output.raw_frame(stamp, sensor, input);
            match self.raw.try_send().filter(|_| fits) {
                Some(buffer) => {
                    if self.transmitter.start_raw(form, &raw, buffer) {
                        self.raw.send_done();
                        self.shared.wake_transmission();
                    }
                }
                None => dropped += u32::from(self.transmitter.skip_raw(form, &raw)),
            }
        }
        if dropped > 0 {
            self.shared
                .update_status(|status| status.dropped_raw = status.dropped_raw.saturating_add(dropped));
        }
    }
}
