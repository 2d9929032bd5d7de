//! The frame queue: what slow inference costs, and that it is all accounted for.

use core::cell::{Cell, RefCell};

use super::world::{NODE, World, healthy, model_bytes, scan, stamp};
use embassy_futures::select::select3;
use embassy_futures::{block_on, yield_now};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::Channel;
use slipsense::board::{Clock, FrameSource, Observe, SensorFrame, StoppedClock, TxSlot, UnlimitedBus};
use slipsense::health::Status;
use slipsense::net::Model;
use slipsense::params::{FRAME_PERIOD_US, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Output, Pipeline};
use slipsense::sensor::SensorReadings;
use slipsense::tasks::{Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Transmission, acquire};
use slipsense::wire::{CanFrame, DEGRADED_LATE, NodeId, RawForm, RawTransfer, SlipMessage, Transmitter};

const SENSORS: usize = 2;

/// One frame per poll.
struct Counter<const REAL_TIME: bool> {
    next: u32,
    end: u32,
}

impl<const REAL_TIME: bool> FrameSource for Counter<REAL_TIME> {
    const REAL_TIME: bool = REAL_TIME;

    async fn tick(&mut self) -> Option<FrameStamp> {
        yield_now().await;
        (self.next < self.end).then(|| {
            self.next += 1;
            stamp(self.next - 1)
        })
    }

    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        healthy(self.next - 1, parts);
    }
}

struct Ran {
    status: Status,
    sent: Vec<(TxSlot, CanFrame)>,
}

impl Ran {
    fn of(&self, slot: TxSlot) -> Vec<CanFrame> {
        self.sent.iter().filter(|(of, _)| *of == slot).map(|&(_, frame)| frame).collect()
    }

    fn slip_messages(&self) -> Vec<SlipMessage> {
        let decode = |frame: &CanFrame| {
            SlipMessage::decode(NodeId::DEFAULT, &frame.data()[..frame.data().len() - 1]).unwrap()
        };
        self.of(TxSlot::Slip).iter().map(decode).collect()
    }
}

fn run<const REAL_TIME: bool>(frames: u32, polls: usize, clock: impl Clock, observer: impl Observe) -> Ran {
    let model = model_bytes();
    let pipeline = Pipeline::new(Model::parse(&model).unwrap(), SENSORS).unwrap();
    let shared = Shared::<NoopRawMutex>::new();
    let mut raw_buffers = [const { RawTransfer::new() }; RAW_MESSAGES];
    let mut raw_queue = RawQueue::new(&mut raw_buffers);
    let (raw_sender, raw_receiver) = raw_queue.split();
    let mut inference =
        Inference::new(pipeline, Transmitter::new(NODE), clock, observer, &shared, raw_sender);
    let sent = RefCell::new(Vec::new());
    let bus = UnlimitedBus(|slot, frame: &CanFrame| sent.borrow_mut().push((slot, *frame)));
    let mut transmission = Transmission::new(bus, StoppedClock, &shared, raw_receiver);
    let mut buffers = [const { SensorFrame::new() }; QUEUED_FRAMES];
    let mut channel = Channel::<NoopRawMutex, _>::new(&mut buffers);
    let (sender, mut receiver) = channel.split();
    let mut source = Counter::<REAL_TIME> { next: 0, end: frames };
    let acquisition = async {
        acquire(&mut source, sender, &shared).await;
        // Let inference empty the queue.
        for _ in 0..10_000 {
            yield_now().await;
        }
    };
    let deciding = async {
        loop {
            inference.serve(&mut receiver).await;
            for _ in 0..polls {
                yield_now().await;
            }
        }
    };
    block_on(select3(acquisition, deciding, transmission.run()));
    Ran { status: shared.status(), sent: sent.take() }
}

#[test]
fn slow_inference_drops_whole_frames_and_counts_them() {
    let ticks = 400;
    let ran = run::<true>(ticks, 50, StoppedClock, ());
    let slips = ran.slip_messages();

    assert!(ran.status.dropped_frames > 300, "a decision takes 50 ticks: {:?}", ran.status);
    assert_eq!(ran.status.acquired_frames + ran.status.dropped_frames, ticks);
    assert_eq!(ran.status.decided_frames, ran.status.acquired_frames);
    assert_eq!(slips.len() as u32, ran.status.acquired_frames, "what was queued was decided");
    for (message, sent_before) in slips.iter().zip(0..) {
        assert_eq!(message.timestamp_us, stamp(message.sequence).timestamp_us);
        let dropped = (message.sequence - sent_before) as u8;
        assert_eq!(message.late_frames, dropped, "the gaps in the sequence numbers are the dropped frames");
        assert_eq!(message.contact[1].sum, scan(message.sequence, 1).sum(), "readings of this very frame");
    }
}

#[test]
fn a_recording_waits_and_loses_nothing() {
    let frames = 60;
    let ran = run::<false>(frames, 5, StoppedClock, ());
    assert_eq!((ran.status.acquired_frames, ran.status.dropped_frames), (frames, 0));
    assert_eq!((ran.status.late_frames, ran.status.dropped_raw), (0, 0));

    let sent = [TxSlot::Slip, TxSlot::Raw].map(|slot| ran.of(slot));
    let made = World::new(frames, SENSORS).can_frames(RawForm::Plain);
    assert!(sent == made, "the tasks send what the pipeline and the wire make");
}

/// The time of the last frame, and how late every frame is, µs.
#[derive(Clone, Copy)]
struct Behind<'a>(&'a Cell<u64>, u64);

impl Clock for Behind<'_> {
    fn now_us(&self) -> u64 {
        self.0.get() + self.1
    }
}

impl Observe for Behind<'_> {
    fn step_ends(&mut self, stamp: FrameStamp, _output: &Output) {
        self.0.set(stamp.timestamp_us);
    }
}

#[test]
fn a_decision_is_late_after_one_frame_period() {
    for (late_us, late) in [(0, 0), (FRAME_PERIOD_US, 0), (FRAME_PERIOD_US + 1, 20)] {
        let frame = Cell::new(0);
        let behind = Behind(&frame, late_us);
        let ran = run::<false>(20, 0, behind, behind);
        assert_eq!(ran.status.late_frames, late, "{late_us} µs after the tick");
        assert_eq!(u64::from(ran.status.worst_frame_us), late_us, "to the microsecond");
        let last = ran.slip_messages().pop().unwrap();
        assert_eq!(u32::from(last.late_frames), late, "the slip message tells");
        assert_eq!(last.degraded & DEGRADED_LATE != 0, late > 0);
    }
}
