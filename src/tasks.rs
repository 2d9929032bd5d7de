//! What runs above the seam: acquisition fills a bounded queue of frame buffers, inference empties it
//! onto the bus. Frames are written once, into the queue's own buffers, and read there.
//!
//! The queue is where lost time shows. A real-time source that finds it full drops the whole frame; the
//! gap in the sequence numbers says which, and [`SlipMessage::late_frames`] counts it together with the
//! decisions that came after the next tick: a dropped frame's decision never comes.
//!
//! [`SlipMessage::late_frames`]: crate::wire::SlipMessage::late_frames

use core::borrow::BorrowMut;

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::zerocopy_channel::{Receiver, Sender};

use crate::board::{CanTransmit, Clock, FrameSource, Observe, SensedFrame};
use crate::params::FRAME_RATE_HZ;
use crate::pipeline::{Output, Pipeline, State};
use crate::sensor::SensorInput;
use crate::wire::{RawBuffer, Transmitter};

/// Frame buffers of the queue: one being written, one being read, two that absorb a slow frame.
pub const QUEUED_FRAMES: usize = 4;

/// Time from a tick to the next, rounded up to microseconds; a decision that takes longer is late.
pub const FRAME_PERIOD_US: u64 = 1_000_000u64.div_ceil(FRAME_RATE_HZ as u64);

/// Move frames from the board into the queue until the source ends, which a board's never does.
pub async fn acquire<M: RawMutex, S: FrameSource>(
    source: &mut S,
    mut queue: Sender<'_, M, SensedFrame>,
) -> Acquired {
    let mut acquired = Acquired::default();
    while let Some(stamp) = source.tick().await {
        let buffer = if S::REAL_TIME { queue.try_send() } else { Some(queue.send().await) };
        let Some(frame) = buffer else {
            source.discard().await;
            acquired.dropped = acquired.dropped.saturating_add(1);
            continue;
        };
        source.read(&mut frame.parts).await;
        frame.stamp = stamp;
        frame.dropped_frames = acquired.dropped;
        queue.send_done();
        acquired.queued = acquired.queued.saturating_add(1);
    }
    acquired
}

/// What became of a source's frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Acquired {
    /// Frames handed to inference.
    pub queued: u32,
    /// Frames for which there was no buffer.
    pub dropped: u32,
}

/// Everything between the queue and the bus.
pub struct Inference<'m, T, C, O, S = State> {
    /// The signal path.
    pub pipeline: Pipeline<'m, S>,
    /// Makes CAN frames of messages.
    pub transmitter: Transmitter,
    /// The bus.
    pub bus: T,
    /// The clock that stamped the ticks.
    pub clock: C,
    /// Whoever else wants to see the results.
    pub observer: O,
    /// What went wrong so far.
    pub losses: Losses,
    raw: RawBuffer,
}

/// What went wrong between queue and bus, since start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Frames whose decision came more than a frame period after their tick.
    pub late_frames: u32,
    /// CAN frames that the bus refused.
    pub refused_can_frames: u32,
}

impl<'m, T: CanTransmit, C: Clock, O: Observe, S: BorrowMut<State>> Inference<'m, T, C, O, S> {
    /// Before the first frame.
    pub const fn new(
        pipeline: Pipeline<'m, S>,
        transmitter: Transmitter,
        bus: T,
        clock: C,
        observer: O,
    ) -> Self {
        let losses = Losses { late_frames: 0, refused_can_frames: 0 };
        Self { pipeline, transmitter, bus, clock, observer, losses, raw: RawBuffer::new() }
    }

    /// Serve the queue for ever.
    pub async fn run<M: RawMutex>(&mut self, mut queue: Receiver<'_, M, SensedFrame>) -> ! {
        loop {
            self.serve(&mut queue).await;
        }
    }

    /// Wait for one frame, decide, send the slip message and then the raw frames.
    pub async fn serve<M: RawMutex>(&mut self, queue: &mut Receiver<'_, M, SensedFrame>) {
        let frame = queue.receive().await;
        let inputs = frame.parts.each_ref().map(|part| part.input());
        self.observer.step_begins(frame.stamp);
        let output = self.pipeline.step(&inputs);
        self.observer.step_ends(frame.stamp, &output);
        self.send(frame, &inputs, &output).await;
        self.observer.frame_sent(frame.stamp);
        queue.receive_done();
    }

    async fn send(&mut self, frame: &SensedFrame, inputs: &[SensorInput<'_>], output: &Output) {
        let stamp = frame.stamp;
        let age_us = self.clock.now_us().saturating_sub(stamp.timestamp_us);
        if age_us > FRAME_PERIOD_US {
            self.losses.late_frames = self.losses.late_frames.saturating_add(1);
        }
        let late_frames = self.losses.late_frames.saturating_add(frame.dropped_frames);
        let late_frames = u16::try_from(late_frames).unwrap_or(u16::MAX);
        let slip = self.transmitter.slip(&output.slip_message(stamp, late_frames));
        let mut refused = self.bus.transmit(&slip).await.is_err() as u32;

        let parts = inputs.iter().zip(&frame.parts).take(output.sensors);
        for (sensor, (&input, part)) in parts.enumerate() {
            let raw = output.raw_frame(stamp, sensor, input, part.xl_end);
            for can_frame in self.transmitter.raw(&raw, &mut self.raw) {
                refused += self.bus.transmit(&can_frame).await.is_err() as u32;
            }
        }
        self.losses.refused_can_frames = self.losses.refused_can_frames.saturating_add(refused);
    }
}
