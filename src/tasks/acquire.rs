//! From the board into the frame queue. Frames are written once, into the queue's own buffers, and read there.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::zerocopy_channel::Sender;

use super::{Shared, Task};
use crate::board::{FrameSource, SensorFrame};

/// Frame buffers of the queue: one being written, one being read, two that absorb a slow frame.
pub const QUEUED_FRAMES: usize = 4;

/// Move frames from the board into the queue until the source ends, which a board's never does.
///
/// The queue is where lost time shows. A real-time source that finds it full drops the whole frame; the gap in the
/// sequence numbers says which, and [`SlipMessage::late_frames`] counts it together with the decisions that came
/// after the next tick: a dropped frame's decision never comes.
///
/// [`SlipMessage::late_frames`]: crate::wire::SlipMessage::late_frames
pub async fn acquire<M: RawMutex, S: FrameSource>(
    source: &mut S,
    mut queue: Sender<'_, M, SensorFrame>,
    shared: &Shared<M>,
) {
    let mut dropped_frames: u32 = 0;
    while let Some(stamp) = source.tick().await {
        shared.progress.made(Task::Acquire);
        let buffer = if S::REAL_TIME { queue.try_send() } else { Some(queue.send().await) };
        let Some(frame) = buffer else {
            dropped_frames = dropped_frames.saturating_add(1);
            shared.update_status(|status| status.dropped_frames = dropped_frames);
            continue;
        };
        source.read(&mut frame.parts).await;
        frame.stamp = stamp;
        frame.dropped_frames = dropped_frames;
        queue.send_done();
        shared.update_status(|status| status.acquired_frames = status.acquired_frames.wrapping_add(1));
    }
}
