//! Acquisition and inference above the seam: what a slow bus costs, and that it is all accounted for.

use core::cell::{Cell, RefCell};
use std::rc::Rc;

use embassy_futures::select::{Either, select};
use embassy_futures::{block_on, yield_now};
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::Channel;
use slipsense::board::{CanTransmit, Clock, FrameSource, Observe, SensedFrame, SensedPart, StoppedClock};
use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense::params::{MAX_SENSORS, TAXELS};
use slipsense::pipeline::{FrameStamp, Output, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::tasks::{Acquired, FRAME_PERIOD_US, Inference, Losses, QUEUED_FRAMES, acquire};
use slipsense::wire::{CanFrame, NodeId, RawBuffer, SLIP_PORT, SlipMessage, Transmitter};
use slipsense_model_file::random_model;

const SENSORS: usize = 2;
const NODE: NodeId = NodeId::new(42).unwrap();

/// One frame per poll, each with its number written into the readings.
struct Counter<const REAL_TIME: bool> {
    next: u32,
    end: u32,
    discarded: u32,
}

fn stamp(sequence: u32) -> FrameStamp {
    FrameStamp { sequence, timestamp_us: u64::from(sequence) * 1_000_000 / 240 }
}

fn scan(sequence: u32) -> PiezoFrame {
    PiezoFrame::from_scan([(sequence % 4096) as u16; TAXELS])
}

fn samples(sequence: u32) -> [XlSample; 33] {
    core::array::from_fn(|i| [sequence as i16, i as i16 * 100, -(i as i16)])
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

    async fn read(&mut self, parts: &mut [SensedPart; MAX_SENSORS]) {
        let sequence = self.next - 1;
        for part in parts.iter_mut().take(SENSORS) {
            part.piezo = scan(sequence);
            part.piezo_arrived = true;
            part.xl.clear();
            part.xl.extend_from_slice(&samples(sequence)).unwrap();
            part.xl_arrived = true;
            part.xl_end = (sequence + 1) * 33;
        }
    }

    async fn discard(&mut self) {
        self.discarded += 1;
    }
}

/// Takes some polls per CAN frame and refuses one in `refuse_every`.
#[derive(Clone)]
struct Bus {
    polls: usize,
    refuse_every: Option<usize>,
    sent: Rc<RefCell<Vec<CanFrame>>>,
}

impl Bus {
    fn new(polls: usize) -> Self {
        Self { polls, refuse_every: None, sent: Rc::default() }
    }
}

impl CanTransmit for Bus {
    type Error = ();

    async fn transmit(&mut self, frame: &CanFrame) -> Result<(), ()> {
        for _ in 0..self.polls {
            yield_now().await;
        }
        self.sent.borrow_mut().push(*frame);
        match self.refuse_every {
            Some(n) if self.sent.borrow().len().is_multiple_of(n) => Err(()),
            _ => Ok(()),
        }
    }
}

/// What one run leaves behind.
struct Ran {
    acquired: Acquired,
    discarded: u32,
    losses: Losses,
    sent: Vec<CanFrame>,
}

impl Ran {
    fn slip_messages(&self) -> Vec<SlipMessage> {
        let slips = self.sent.iter().filter(|frame| port(frame) == SLIP_PORT);
        slips.map(|frame| SlipMessage::decode(&frame.data()[..frame.data().len() - 1]).unwrap()).collect()
    }
}

fn port(frame: &CanFrame) -> u16 {
    slipsense::wire::MessageId::from_can(frame.id()).unwrap().port
}

fn model_bytes() -> Vec<u8> {
    let dims = Dims { conv_channels: [1, 2, 3], embed: 4, xl_kernel: 2, xl_channels: 3, heads: 2, window: 5 };
    random_model(dims, 1).to_bytes().unwrap()
}

fn run<const REAL_TIME: bool>(frames: u32, bus: Bus, clock: impl Clock, observer: impl Observe) -> Ran {
    let model = model_bytes();
    let pipeline = Pipeline::new(Model::parse(&model).unwrap(), SENSORS).unwrap();
    let sent = bus.sent.clone();
    let mut inference = Inference::new(pipeline, Transmitter::new(NODE), bus, clock, observer);
    let mut buffers = [const { SensedFrame::new() }; QUEUED_FRAMES];
    let mut channel = Channel::<NoopRawMutex, _>::new(&mut buffers);
    let (sender, receiver) = channel.split();
    let mut source = Counter::<REAL_TIME> { next: 0, end: frames, discarded: 0 };
    let acquisition = async {
        let acquired = acquire(&mut source, sender).await;
        // Let inference empty the queue.
        for _ in 0..10_000 {
            yield_now().await;
        }
        acquired
    };
    let acquired = match block_on(select(acquisition, inference.run(receiver))) {
        Either::First(acquired) => acquired,
        Either::Second(never) => never,
    };
    let losses = inference.losses;
    let sent = sent.take();
    Ran { acquired, discarded: source.discarded, losses, sent }
}

#[test]
fn a_slow_bus_drops_whole_frames_and_counts_them() {
    let ticks = 400;
    let ran = run::<true>(ticks, Bus::new(1), StoppedClock, ());
    let slips = ran.slip_messages();

    assert!(ran.acquired.dropped > 300, "the bus needs over 50 polls a frame: {:?}", ran.acquired);
    assert_eq!(ran.acquired.queued + ran.acquired.dropped, ticks);
    assert_eq!(ran.discarded, ran.acquired.dropped);
    assert_eq!(slips.len(), ran.acquired.queued as usize, "what was queued was sent");
    for (message, sent_before) in slips.iter().zip(0..) {
        assert_eq!(message.timestamp_us, stamp(message.sequence).timestamp_us);
        assert_eq!(
            u32::from(message.late_frames),
            message.sequence - sent_before,
            "the gaps in the sequence numbers are the dropped frames"
        );
        assert_eq!(message.contact[1].sum, scan(message.sequence).sum(), "readings of this very frame");
    }
}

#[test]
fn a_recording_waits_and_loses_nothing() {
    let frames = 60;
    let ran = run::<false>(frames, Bus::new(1), StoppedClock, ());
    assert_eq!(ran.acquired, Acquired { queued: frames, dropped: 0 });
    assert_eq!(ran.discarded, 0);
    assert_eq!(ran.losses, Losses::default());

    let model = model_bytes();
    let mut pipeline = Pipeline::new(Model::parse(&model).unwrap(), SENSORS).unwrap();
    let mut transmitter = Transmitter::new(NODE);
    let mut buffer = RawBuffer::new();
    let mut expected = Vec::new();
    for sequence in 0..frames {
        let (piezo, xl, stamp) = (scan(sequence), samples(sequence), stamp(sequence));
        let input = SensorInput { piezo: Some(&piezo), xl: Some(&xl) };
        let output = pipeline.step(&[input; SENSORS]);
        expected.push(transmitter.slip(&output.slip_message(stamp, 0)));
        for sensor in 0..SENSORS {
            let raw = output.raw_frame(stamp, sensor, input, (sequence + 1) * 33);
            expected.extend(transmitter.raw(&raw, &mut buffer));
        }
    }
    assert!(ran.sent == expected, "the tasks send what the pipeline and the wire make, slip first");
}

/// Late by `late_us` at every frame.
struct Behind<'a> {
    frame: &'a Cell<u64>,
    late_us: u64,
}

impl Clock for Behind<'_> {
    fn now_us(&self) -> u64 {
        self.frame.get() + self.late_us
    }
}

struct SetClock<'a>(&'a Cell<u64>);

impl Observe for SetClock<'_> {
    fn step_ends(&mut self, stamp: FrameStamp, _output: &Output) {
        self.0.set(stamp.timestamp_us);
    }
}

#[test]
fn a_decision_is_late_after_one_frame_period() {
    for (late_us, late) in [(0, 0), (FRAME_PERIOD_US, 0), (FRAME_PERIOD_US + 1, 20)] {
        let frame = Cell::new(0);
        let ran = run::<false>(20, Bus::new(0), Behind { frame: &frame, late_us }, SetClock(&frame));
        assert_eq!(ran.losses.late_frames, late, "{late_us} µs after the tick");
        let last = ran.slip_messages().pop().unwrap();
        assert_eq!(u32::from(last.late_frames), late, "the slip message tells");
    }
}

#[test]
fn refused_can_frames_are_counted() {
    let bus = Bus { refuse_every: Some(10), ..Bus::new(0) };
    let ran = run::<false>(20, bus, StoppedClock, ());
    assert_eq!(ran.losses.refused_can_frames as usize, ran.sent.len() / 10);
    assert_eq!(ran.losses.late_frames, 0);
}
