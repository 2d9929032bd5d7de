//! Virtual time, a sensor source that ticks in it, and the modelled bus as a board's CAN hardware. Computing takes no
//! time here.

use std::cell::{Cell, RefCell};
use std::collections::BTreeSet;
use std::future::{Future, poll_fn};
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::{Context, Poll, Wake, Waker};

use embassy_futures::select::select3;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embassy_sync::zerocopy_channel::Channel;
use slipsense::board::{CanTransmit, Clock, FrameSource, SensorFrame, TxSlot, Watchdog};
use slipsense::health::{CanStatus, Status};
use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense::params::{MAX_SENSORS, TAXEL_COLS, TAXELS};
use slipsense::pipeline::{FrameStamp, Output, Pipeline};
use slipsense::sensor::{PiezoFrame, SensorReadings};
use slipsense::tasks::{Inference, QUEUED_FRAMES, RAW_MESSAGES, RawQueue, Shared, Transmission, acquire};
use slipsense::wire::{
    CanFrame, NodeId, Origin, RawBuffer, RawForm, RawMessage, RawTransfer, Received, Receiver, SlipMessage,
    Transmitter,
};
use slipsense_can_sim::controller::{Arrived, Bus, Disturbance, Timing};
use slipsense_recording::model_file::random_model;

pub const NODE: NodeId = NodeId::new(42).unwrap();
pub const FRAME_NS: u64 = 1_000_000_000 / 240;
/// Samples that a frame brings.
pub const BATCH: u32 = 33;
/// From the last tick until everything is looked at.
const AFTERWARDS_NS: u64 = 200_000_000;

/// Time that stands still until all tasks wait, then moves on to the next alarm.
#[derive(Default)]
pub struct Time {
    now_ns: Cell<u64>,
    alarms: RefCell<BTreeSet<u64>>,
}

impl Clock for Time {
    fn now_us(&self) -> u64 {
        self.now_ns.get() / 1000
    }
}

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

impl Time {
    /// Wait; `None`: for ever.
    pub async fn until(&self, ns: Option<u64>) {
        poll_fn(|_| match ns {
            Some(ns) if ns <= self.now_ns.get() => Poll::Ready(()),
            _ => {
                self.alarms.borrow_mut().extend(ns);
                Poll::Pending
            }
        })
        .await;
    }

    pub fn run<T>(&self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        let woken = Arc::new(Woken(AtomicBool::new(false)));
        let waker = Waker::from(woken.clone());
        loop {
            if let Poll::Ready(result) = future.as_mut().poll(&mut Context::from_waker(&waker)) {
                return result;
            }
            if woken.0.swap(false, Ordering::Relaxed) {
                continue;
            }
            let next = self.alarms.borrow_mut().pop_first().expect("nobody waits for a time: a deadlock");
            self.now_ns.set(next.max(self.now_ns.get()));
        }
    }
}

/// A watchdog, and how often it was fed.
pub struct Fed(pub u32);

impl Watchdog for Fed {
    fn feed(&mut self) {
        self.0 += 1;
    }
}

struct Hardware<'a> {
    time: &'a Time,
    bus: &'a RefCell<Bus>,
    arrived: &'a RefCell<Vec<Arrived>>,
    seen: ([bool; 3], CanStatus),
}

impl Hardware<'_> {
    fn look(&self) -> ([bool; 3], CanStatus) {
        let mut bus = self.bus.borrow_mut();
        bus.advance(self.time.now_ns.get(), |frame| self.arrived.borrow_mut().push(frame));
        (TxSlot::ALL.map(|slot| bus.is_free(slot)), bus.status())
    }
}

impl CanTransmit for Hardware<'_> {
    fn is_free(&self, slot: TxSlot) -> bool {
        self.look().0[slot as usize]
    }

    fn transmit(&mut self, slot: TxSlot, frame: &CanFrame) {
        self.bus.borrow_mut().put(slot, frame, self.time.now_ns.get());
        self.seen = self.look();
    }

    fn withdraw(&mut self, slot: TxSlot) {
        self.bus.borrow_mut().withdraw(slot);
        self.seen = self.look();
    }

    fn has_sent(&self, slot: TxSlot) -> bool {
        self.look();
        self.bus.borrow().has_sent(slot)
    }

    async fn changed(&mut self) {
        loop {
            let now = self.look();
            if now != self.seen {
                self.seen = now;
                return;
            }
            let next = self.bus.borrow().next_event_ns();
            self.time.until(next).await;
        }
    }

    fn status(&mut self) -> CanStatus {
        self.look().1
    }
}

pub struct World<'a> {
    pub frames: u32,
    pub sensors: usize,
    pub disturbance: Disturbance,
    /// What the sensors of one frame deliver, by its number.
    pub script: &'a (dyn Fn(u32, &mut [SensorReadings; MAX_SENSORS]) + 'a),
    /// Called with what the tasks share before the first frame, then before every tick.
    pub before_tick: &'a (dyn Fn(&Shared<NoopRawMutex>, u32) + 'a),
    /// Sequence number of frame 0; the script and the time count from 0.
    pub first_sequence: u32,
    /// How long reading the sensors of a frame takes.
    pub read_ns: &'a dyn Fn(u32) -> u64,
    /// Called with the bus before every tick: for what changes on it while the tasks run.
    pub on_bus: &'a dyn Fn(u32, &mut Bus),
    /// Gets every frame at the tick after its arrival, and none is kept in [`Ran`].
    pub sink: Option<&'a dyn Fn(Arrived)>,
    /// From the last tick to the end; what has not arrived by then never does.
    pub afterwards_ns: u64,
}

/// All sensors deliver all of a frame.
pub fn healthy(sequence: u32, parts: &mut [SensorReadings; MAX_SENSORS]) {
    for (sensor, part) in (0..).zip(parts) {
        part.piezo = scan(sequence, sensor);
        let sample = |i: u32| {
            let n = (sequence * BATCH + i).wrapping_mul(2_654_435_761 + sensor);
            [(n >> 18) as i16 - 8192, (n >> 20) as i16, -((n >> 19) as i16 >> 2)]
        };
        part.xl.clear();
        part.xl.extend((0..BATCH).map(sample));
        (part.piezo_arrived, part.xl_arrived) = (true, true);
        part.xl_end = (sequence + 1) * BATCH;
    }
}

pub fn scan(sequence: u32, sensor: u32) -> PiezoFrame {
    PiezoFrame::from_scan(std::array::from_fn::<u16, TAXELS, _>(|i| {
        ((i as u32 * 7 + sequence * 13 + sensor * 101) % 3000) as u16
    }))
}

/// The message holds these counts in its region, and nothing elsewhere.
pub fn assert_taxels(message: &RawMessage, scan: &PiezoFrame) {
    for (index, (&got, &count)) in message.piezo.counts().iter().zip(scan.counts()).enumerate() {
        let sent = message.region.cols(index / TAXEL_COLS).contains(&(index % TAXEL_COLS));
        assert_eq!(got, if sent { count } else { 0 }, "taxel {index} of frame {}", message.sequence);
    }
}

/// Ticks on time; frame 0 closes a period after the start.
struct Sensors<'a> {
    time: &'a Time,
    world: &'a World<'a>,
    shared: &'a Shared<NoopRawMutex>,
    bus: &'a RefCell<Bus>,
    arrived: &'a RefCell<Vec<Arrived>>,
    next: u32,
}

pub const fn tick_ns(sequence: u32) -> u64 {
    (sequence as u64 + 1) * 1_000_000_000 / 240
}

pub fn stamp(sequence: u32) -> FrameStamp {
    FrameStamp { sequence, timestamp_us: tick_ns(sequence) / 1000 }
}

impl FrameSource for Sensors<'_> {
    const REAL_TIME: bool = true;

    async fn tick(&mut self) -> Option<FrameStamp> {
        if self.next == self.world.frames {
            return None;
        }
        (self.world.before_tick)(self.shared, self.next);
        (self.world.on_bus)(self.next, &mut self.bus.borrow_mut());
        if let Some(sink) = self.world.sink {
            self.arrived.borrow_mut().drain(..).for_each(sink);
        }
        self.time.until(Some(tick_ns(self.next))).await;
        let stamp = stamp(self.next);
        self.next += 1;
        Some(FrameStamp { sequence: self.world.first_sequence.wrapping_add(stamp.sequence), ..stamp })
    }

    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        let frame = self.next - 1;
        self.time.until(Some(self.time.now_ns.get() + (self.world.read_ns)(frame))).await;
        (self.world.script)(frame, parts);
    }
}

pub struct Ran {
    pub arrived: Vec<Arrived>,
    pub status: Status,
    pub slips: Vec<SlipMessage>,
    pub raw: Vec<RawMessage>,
    /// What the receiver could make nothing of.
    pub errors: usize,
    /// Raw messages that had not left at the end.
    pub waiting: usize,
}

impl Ran {
    /// Raw messages of each sensor.
    pub fn shares(&self) -> [usize; MAX_SENSORS] {
        [0, 1, 2].map(|sensor| self.raw.iter().filter(|message| message.sensor == sensor).count())
    }
}

pub fn model_bytes() -> Vec<u8> {
    let dims = Dims { conv_channels: [1, 2, 3], embed: 4, xl_kernel: 2, xl_channels: 3, heads: 2, window: 5 };
    random_model(dims, 1).to_bytes().unwrap()
}

impl World<'_> {
    pub fn new(frames: u32, sensors: usize) -> Self {
        Self {
            frames,
            sensors,
            disturbance: Disturbance::default(),
            script: &healthy,
            before_tick: &|_, _| {},
            first_sequence: 0,
            read_ns: &|_| 0,
            on_bus: &|_, _| {},
            sink: None,
            afterwards_ns: AFTERWARDS_NS,
        }
    }

    pub fn run(&self) -> Ran {
        let time = Time::default();
        let shared = Shared::<NoopRawMutex>::new();
        let model = model_bytes();
        let pipeline = Pipeline::new(Model::parse(&model).unwrap(), self.sensors).unwrap();
        let mut raw_buffers = [const { RawTransfer::new() }; RAW_MESSAGES];
        let mut raw_queue = RawQueue::new(&mut raw_buffers);
        let (raw_sender, raw_receiver) = raw_queue.split();
        let mut buffers = [const { SensorFrame::new() }; QUEUED_FRAMES];
        let mut channel = Channel::<NoopRawMutex, _>::new(&mut buffers);
        let (sender, receiver) = channel.split();
        let mut inference = Inference::new(pipeline, Transmitter::new(NODE), &time, (), &shared, raw_sender);
        let fast = Timing::new(80_000_000, 1_000_000, 8_000_000).unwrap();
        let (bus, arrived) = (RefCell::new(Bus::new(&fast, self.disturbance.clone())), RefCell::default());
        let seen = ([true; 3], CanStatus::default());
        let mut source =
            Sensors { time: &time, world: self, shared: &shared, bus: &bus, arrived: &arrived, next: 0 };
        let hardware = Hardware { time: &time, bus: &bus, arrived: &arrived, seen };
        let mut transmission = Transmission::new(hardware, &time, &shared, raw_receiver);
        let source = async {
            acquire(&mut source, sender, &shared).await;
            time.until(Some(tick_ns(self.frames) - FRAME_NS + self.afterwards_ns)).await;
        };
        time.run(select3(source, inference.run(receiver), transmission.run()));
        if let Some(sink) = self.sink {
            arrived.borrow_mut().drain(..).for_each(sink);
        }
        let (slips, raw) = (Vec::new(), Vec::new());
        let waiting = transmission.waiting_raw();
        let mut ran =
            Ran { arrived: arrived.take(), status: shared.status(), slips, raw, errors: 0, waiting };
        let mut receiver = Receiver::new(NODE);
        for arrived in &ran.arrived {
            match receiver.accept(&arrived.frame) {
                Ok(None) => {}
                Ok(Some(Received::Slip(message))) => ran.slips.push(message),
                Ok(Some(Received::Raw(message))) => ran.raw.push(message),
                Err(_) => ran.errors += 1,
            }
        }
        ran
    }

    /// Slip and raw CAN frames that the pipeline and the wire make of the script, called directly.
    pub fn can_frames(&self, form: RawForm) -> [Vec<CanFrame>; 2] {
        let (mut transmitter, mut buffer) = (Transmitter::new(NODE), RawBuffer::new());
        let (mut slips, mut raws) = (Vec::new(), Vec::new());
        let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
        for (sequence, output) in (0..).zip(self.outputs()) {
            (self.script)(sequence, &mut parts);
            slips.push(transmitter.slip(&output.slip_message(stamp(sequence), &Origin::default())));
            for (sensor, part) in parts.iter().enumerate().take(self.sensors) {
                let raw = output.raw_frame(stamp(sequence), sensor, part.input());
                raws.extend(transmitter.raw_as(form, &raw, &mut buffer));
            }
        }
        [slips, raws]
    }

    /// What the pipeline makes of the script, called directly.
    pub fn outputs(&self) -> Vec<Output> {
        let model = model_bytes();
        let mut pipeline = Pipeline::new(Model::parse(&model).unwrap(), self.sensors).unwrap();
        let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
        let step = |sequence| {
            (self.script)(sequence, &mut parts);
            pipeline.step(&parts.each_ref().map(|part| part.input()))
        };
        (0..self.frames).map(step).collect()
    }
}
