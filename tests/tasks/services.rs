//! The services task in virtual time: what it answers, applies and reports, and that it moves on whatever the board
//! is busy with.

use std::cell::{Cell, RefCell};
use std::collections::VecDeque;

use embassy_futures::select::select3;
use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use slipsense::board::crash_record::{CrashRecord, ResetCause, Start};
use slipsense::board::{CanReceive, CanTransmit, Clock, StatusLed, TxSlot};
use slipsense::fixed::Logit;
use slipsense::health::{self, CanState, CanStatus, Condition, SelfChecks, SensorHealth, Status};
use slipsense::net::format::OperatingPoint;
use slipsense::node::{
    ACCESS_PORT, CALIBRATE, CHALLENGE_BYTES, COMMAND_PORT, FileSink, GET_INFO_PORT, HEARTBEAT_PORT, IDENTIFY,
    Identity, Node, RECORD_PORT, RESTART, SELF_TEST, SIGNATURE_BYTES, STORE, UpdateTarget,
};
use slipsense::params::MAX_SENSORS;
use slipsense::settings::Settings;
use slipsense::tasks::{
    RAW_MESSAGES, RawQueue, RuntimeConfig, ServiceBoard, Services, Shared, Supervisor, Task, Transmission,
};
use slipsense::update::{self, Evidence, Notice, Trial};
use slipsense::wire::{CanFrame, RawTransfer, Sessions, TransferId};

use super::world::{Fed, NODE, Time};
use crate::node::commands::command;
use crate::node::registers::access;
use crate::node::{identity, request, text};

const MS: u64 = 1_000_000;

/// The bus: what arrives when, what was sent when.
#[derive(Default)]
pub struct Bus {
    arriving: RefCell<VecDeque<(u64, CanFrame)>>,
    sent: RefCell<Vec<(u64, CanFrame)>>,
    filters: RefCell<Vec<(u32, u32)>>,
    pub off: Cell<bool>,
}

/// The board's end of it.
struct Wire<'a>(&'a Bus, &'a Time);

impl CanReceive for Wire<'_> {
    async fn receive(&mut self, until_us: u64) -> Option<(CanFrame, u64)> {
        loop {
            let next = self.0.arriving.borrow().front().map(|(ms, _)| ms * MS);
            let now_us = self.1.now_us();
            if next.is_some_and(|ns| ns <= now_us * 1000) {
                let (_, frame) = self.0.arriving.borrow_mut().pop_front()?;
                return Some((frame, now_us));
            }
            if now_us >= until_us {
                return None;
            }
            self.1.until(Some(next.unwrap_or(u64::MAX).min(until_us * 1000))).await;
        }
    }

    fn accept_only(&mut self, filters: &[(u32, u32)]) {
        *self.0.filters.borrow_mut() = filters.to_vec();
    }
}

impl CanTransmit for Wire<'_> {
    fn is_free(&self, _: TxSlot) -> bool {
        !self.0.off.get()
    }

    fn transmit(&mut self, _: TxSlot, frame: &CanFrame) {
        self.0.sent.borrow_mut().push((self.1.now_us(), *frame));
    }

    fn withdraw(&mut self, _: TxSlot) {}

    fn has_sent(&self, _: TxSlot) -> bool {
        true
    }

    async fn changed(&mut self) {
        self.1.until(Some(self.1.now_us() * 1000 + MS)).await;
    }

    fn status(&mut self) -> CanStatus {
        let state = if self.0.off.get() { CanState::BusOff } else { CanState::ErrorActive };
        CanStatus { state, ..CanStatus::default() }
    }
}

/// What the tasks asked of the board, and when.
#[derive(Default)]
pub struct BoardLog {
    stored: Option<Settings>,
    stored_from_us: u64,
    applied: Vec<[(bool, bool); MAX_SENSORS]>,
    shown: Vec<Condition>,
    lit: Vec<bool>,
    pub confirmed_ms: Vec<u64>,
}

struct Board<'a> {
    time: &'a Time,
    log: &'a RefCell<BoardLog>,
    store_ms: u64,
    notices: VecDeque<Notice>,
    trial: Trial,
}

impl StatusLed for Board<'_> {
    fn show(&mut self, condition: Condition) {
        self.log.borrow_mut().shown.push(condition);
    }
}

impl FileSink for Board<'_> {
    async fn write(&mut self, _: UpdateTarget, _: u32, _: &[u8]) -> Result<(), &'static str> {
        Ok(())
    }

    async fn finish(&mut self, _: UpdateTarget, _: u32) -> Result<(), &'static str> {
        Ok(())
    }
}

impl ServiceBoard for Board<'_> {
    async fn store(&mut self, settings: &Settings) -> Result<(), &'static str> {
        self.log.borrow_mut().stored_from_us = self.time.now_us();
        self.time.until(Some(self.time.now_us() * 1000 + self.store_ms * MS)).await;
        self.log.borrow_mut().stored = Some(settings.clone());
        Ok(())
    }

    async fn begin_update(&mut self, _: UpdateTarget) -> Result<u32, &'static str> {
        Err("no room")
    }

    fn next_notice(&mut self) -> Option<Notice> {
        self.notices.pop_front()
    }

    fn unlocks(&mut self, challenge: &[u8; CHALLENGE_BYTES], signature: &[u8; SIGNATURE_BYTES]) -> bool {
        update::unlocks(challenge, signature, &[update::DEVELOPMENT_KEY])
    }

    fn ready_to_confirm(&mut self, evidence: Evidence) -> bool {
        self.trial.observe(evidence)
    }

    async fn confirm(&mut self) {
        self.log.borrow_mut().confirmed_ms.push(self.time.now_us() / 1000);
    }

    fn apply(&mut self, settings: &Settings) {
        self.log.borrow_mut().applied.push(settings.orientation());
    }

    fn observe(&mut self, status: &mut Status) {
        status.stuck_taxels[0].0[3] = 1;
    }

    fn identify(&mut self, lit: bool) {
        self.log.borrow_mut().lit.push(lit);
    }
}

/// One run: frames of requests at their milliseconds, for so long or until the node is to start anew.
pub struct Run<'a> {
    pub requests: &'a [(u64, u16, Vec<u8>)],
    pub ms: u64,
    pub store_ms: u64,
    pub settings: Settings,
    pub start: Start,
    /// What the board says by itself.
    pub notices: Vec<Notice>,
    /// How its firmware came to run.
    pub run: update::Run,
    /// Called every millisecond.
    pub meanwhile: &'a dyn Fn(u64, &Shared<NoopRawMutex>, &Bus),
}

/// A transfer of the node: when it was complete, ms; what it is called; its payload.
pub type Said = (u64, TransferId, Vec<u8>);

pub struct Ran {
    pub said: Vec<Said>,
    pub log: BoardLog,
    pub config: RuntimeConfig,
    filters: usize,
    restarted_ms: Option<u64>,
    /// Longest time without a feed of the watchdog, µs.
    pub unfed_us: u64,
}

impl Run<'_> {
    pub fn new(requests: &[(u64, u16, Vec<u8>)], ms: u64) -> Run<'_> {
        Run {
            requests,
            ms,
            store_ms: 0,
            settings: Settings::new(),
            start: Start::default(),
            notices: Vec::new(),
            run: update::Run::Confirmed,
            meanwhile: &|_, _, _| {},
        }
    }

    pub fn run(self) -> Ran {
        let (time, bus, shared) = (Time::default(), Bus::default(), Shared::<NoopRawMutex>::new());
        for (transfer, (ms, port, payload)) in (0u8..=31).cycle().zip(self.requests) {
            let frames = request(*port, transfer, payload).into_iter().map(|frame| (*ms, frame));
            bus.arriving.borrow_mut().extend(frames);
        }
        let identity = Identity { entropy: Some(4), ..identity() };
        let log = RefCell::<BoardLog>::default();
        let (notices, trial) = (self.notices.into(), Trial::new(self.run));
        let board = Board { time: &time, log: &log, store_ms: self.store_ms, notices, trial };
        let node = Node::new(identity, self.settings);
        let mut services = Services::new(node, Wire(&bus, &time), &time, &shared, board, self.start);
        let mut raw_buffers = [const { RawTransfer::new() }; RAW_MESSAGES];
        let mut raw_queue = RawQueue::new(&mut raw_buffers);
        let (_, raw) = raw_queue.split();
        let mut transmission = Transmission::new(Wire(&bus, &time), &time, &shared, raw);
        let (restarted, unfed_us) = (Cell::new(None), Cell::new(0));
        let life = async {
            services.run().await;
            restarted.set(Some(time.now_us() / 1000));
            // What it has said leaves.
            time.until(Some(time.now_us() * 1000 + 5 * MS)).await;
        };
        let watch = async {
            let mut supervisor = Supervisor::new(&[Task::Services]);
            let mut fed_us = 0;
            for ms in 0..self.ms {
                time.until(Some(ms * MS)).await;
                (self.meanwhile)(ms, &shared, &bus);
                let mut fed = Fed(0);
                let _ = supervisor.look(&shared.progress, &mut fed);
                if fed.0 > 0 {
                    fed_us = time.now_us();
                }
                unfed_us.set(unfed_us.get().max(time.now_us() - fed_us));
            }
        };
        time.run(select3(life, transmission.run(), watch));
        let mut sessions = Box::new(Sessions::<16, 640>::new());
        let mut said = Vec::new();
        for (at_us, frame) in bus.sent.take() {
            let id = TransferId::from_can(frame.id()).unwrap();
            if let Some(arrived) = sessions.accept(id, &frame, at_us).unwrap() {
                said.push((at_us / 1000, id, arrived.payload.to_vec()));
            }
        }
        Ran {
            said,
            log: log.take(),
            config: shared.config(),
            filters: bus.filters.borrow().len(),
            restarted_ms: restarted.get(),
            unfed_us: unfed_us.get(),
        }
    }
}

impl Ran {
    pub fn answers(&self, port: u16) -> Vec<&Said> {
        let of = |id: &TransferId| matches!(id, TransferId::Service(id) if id.port == port);
        self.said.iter().filter(|(_, id, _)| of(id)).collect()
    }

    pub fn messages(&self, port: u16) -> Vec<&Said> {
        let of = |id: &TransferId| matches!(id, TransferId::Message(id) if id.port == port);
        self.said.iter().filter(|(_, id, _)| of(id)).collect()
    }

    pub fn records(&self) -> Vec<String> {
        self.messages(RECORD_PORT).iter().map(|(.., bytes)| text(bytes)).collect()
    }
}

/// Changes the status every millisecond.
pub fn with_status(change: impl Fn(u64, &mut Status)) -> impl Fn(u64, &Shared<NoopRawMutex>, &Bus) {
    move |ms, shared, _| shared.update_status(|status| change(ms, status))
}

/// Frames that are decided in so many milliseconds.
pub fn decided(ms: u64) -> u32 {
    (ms * 240 / 1000) as u32
}

/// What takes long begins after a decision, so that the next frame is not late: not within the last quarter of a period.
#[test]
fn work_begins_where_the_next_frame_has_time() {
    for asked_ms in 1_000..1_016 {
        // A decision 1 ms after each tick; ticks every 4 ms from 2 on.
        let decide = |ms: u64, shared: &Shared<NoopRawMutex>, _: &Bus| {
            if ms % 4 == 3 {
                shared.decided((ms - 1) * 1000);
            }
        };
        let requests = [(asked_ms, COMMAND_PORT, command(STORE, b""))];
        let ran = Run { meanwhile: &decide, ..Run::new(&requests, 1_200) }.run();
        let from_us = ran.log.stored_from_us;
        assert!((asked_ms..asked_ms + 3).contains(&(from_us / 1000)), "asked at {asked_ms} ms: {from_us} us");
        // After the decision of the last tick.
        let since_tick_us = (from_us + 2_000) % 4_000;
        assert!((1_000..=3_125).contains(&since_tick_us), "asked at {asked_ms} ms: {from_us} us");
    }
}

/// Where every decision falls between the last quarter of its period and the next tick, no frame leaves time.
#[test]
fn work_goes_on_where_no_frame_leaves_time() {
    let decide = |ms: u64, shared: &Shared<NoopRawMutex>, _: &Bus| {
        if ms.is_multiple_of(4) {
            shared.decided(ms.saturating_sub(4) * 1000);
        }
    };
    let requests = [(1_000, COMMAND_PORT, command(STORE, b""))];
    let ran = Run { meanwhile: &decide, ..Run::new(&requests, 1_400) }.run();
    let from_us = ran.log.stored_from_us;
    assert!((1_100_000..1_120_000).contains(&from_us), "{from_us} us");
    assert_eq!(ran.answers(COMMAND_PORT)[0].2[0], 0);
}

#[test]
fn the_bus_is_served_while_a_store_takes_four_seconds() {
    let mut requests = vec![(1_000, COMMAND_PORT, command(STORE, b""))];
    requests.extend((0..40).map(|n| (1_010 + 100 * n, GET_INFO_PORT, Vec::new())));
    let ran = Run { store_ms: 4_000, ..Run::new(&requests, 6_500) }.run();
    let infos = ran.answers(GET_INFO_PORT);
    assert_eq!(infos.len(), 40);
    for (asked, (ms, _, _)) in (1_010..).step_by(100).zip(&infos) {
        assert!((asked..asked + 5).contains(ms), "asked at {asked}, answered at {ms}");
    }
    let stored = ran.answers(COMMAND_PORT);
    assert!((5_000..5_005).contains(&stored[0].0), "answered at {} ms", stored[0].0);
    assert_eq!(stored[0].2[0], 0);
    assert_eq!(ran.log.stored, Some(Settings::new()));
    let beats: Vec<_> = ran.messages(HEARTBEAT_PORT).iter().map(|(ms, _, _)| *ms).collect();
    assert_eq!(beats.len(), 7);
    assert!(beats.iter().zip(0..).all(|(ms, n)| ms.abs_diff(n * 1000) <= 2), "{beats:?}");
    assert!(ran.unfed_us <= 25_000);
}

#[test]
fn settings_reach_the_tasks_and_the_board() {
    let mask: Vec<u8> = (0..32u32).flat_map(|row| (row << 7).to_le_bytes()).collect();
    let point: Vec<u8> = [300i32, 2, 5].iter().flat_map(|number| number.to_le_bytes()).collect();
    let requests = [
        (10, ACCESS_PORT, access("slipsense.raw.divider", &[11, 1, 0, 4])),
        (20, ACCESS_PORT, access("slipsense.sensor.1.mask", &[&[9, 32], &mask[..]].concat())),
        (30, ACCESS_PORT, access("slipsense.slip.point", &[&[5, 3], &point[..]].concat())),
        (40, ACCESS_PORT, access("slipsense.slip.override", &[3, 1, 0, 1])),
        (50, ACCESS_PORT, access("slipsense.sensor.orientation", &[11, 3, 0, 1, 2, 3])),
        (55, ACCESS_PORT, access("slipsense.raw.compressed", &[3, 1, 0, 1])),
        (60, COMMAND_PORT, command(IDENTIFY, b"")),
    ];
    let ran = Run::new(&requests, 5_200).run();
    assert_eq!((ran.config.raw_every, ran.config.compress_raw), (4, true));
    assert_eq!(ran.config.masks[1].0, std::array::from_fn(|row| (row as u32) << 7));
    assert_eq!(ran.config.masks[0].0, [0; 32]);
    assert_eq!(ran.config.point, Some(OperatingPoint { threshold: Logit::from_bits(300), k: 2, n: 5 }));
    assert_eq!((ran.config.node, ran.filters), (Some(NODE), 3));
    assert_eq!(ran.config.mountings, [(true, false), (false, true), (true, true)]);
    assert_eq!(ran.log.applied.first(), Some(&[(false, false); 3]));
    assert_eq!(ran.log.applied.last(), Some(&[(true, false), (false, true), (true, true)]));
    assert!(ran.log.lit.windows(2).filter(|pair| pair[0] != pair[1]).count() >= 30, "it blinks");
    assert_eq!(ran.log.shown.last(), Some(&Condition::Nominal));
}

#[test]
fn a_restart_comes_after_its_answer_also_off_the_bus() {
    let requests = [(500, COMMAND_PORT, command(RESTART, b""))];
    let ran = Run::new(&requests, 2_000).run();
    let answer = ran.answers(COMMAND_PORT);
    assert_eq!((answer.len(), answer[0].2[0]), (1, 0));
    let after_ms = ran.restarted_ms.unwrap() - answer[0].0;
    assert!((9..=20).contains(&after_ms), "{after_ms} ms after the answer");
    let off = |ms: u64, _: &Shared<NoopRawMutex>, bus: &Bus| bus.off.set(ms >= 400);
    let ran = Run { meanwhile: &off, ..Run::new(&requests, 2_000) }.run();
    assert_eq!(ran.answers(COMMAND_PORT).len(), 0);
    assert!((600..=621).contains(&ran.restarted_ms.unwrap()));
}

#[test]
fn a_self_test_says_what_is_missing() {
    let requests = [100, 1_000].map(|ms| (ms, COMMAND_PORT, command(SELF_TEST, b"")));
    let frames = with_status(|ms, status| {
        status.decided_frames = decided(ms);
        // Of the two sensors that are not in use nothing is asked.
        let first = if ms > 900 { health::XL_MISSING } else { 0 };
        status.sensor_health = [first, 3, 3].map(SensorHealth);
    });
    let ran = Run { meanwhile: &frames, ..Run::new(&requests, 1_700) }.run();
    let answers = ran.answers(COMMAND_PORT);
    assert_eq!(answers.iter().map(|(_, _, payload)| payload[0]).collect::<Vec<_>>(), [0, 1]);
    let why = "self test: an accelerometer does not deliver";
    assert_eq!(&answers[1].2[2..2 + why.len()], why.as_bytes());
    assert!(ran.records().contains(&why.to_owned()));
    type Found = fn(u64, &mut Status);
    let cases: [(Found, &str); 3] = [
        // The same sample for ever.
        (
            |ms, status| (status.decided_frames, status.frozen) = (decided(ms), true),
            "an accelerometer is frozen",
        ),
        // Half of the frames, no success.
        (|ms, status| status.decided_frames = decided(ms) / 2, "frames are missing"),
        // Without a model none is decided.
        (|_, status| status.sensor_health[0] = SensorHealth(health::NO_MODEL), "no readable model"),
    ];
    for (found, why) in cases {
        let ran = Run { meanwhile: &with_status(found), ..Run::new(&requests[..1], 700) }.run();
        assert_eq!(ran.answers(COMMAND_PORT)[0].2[0], 1, "{why}");
        assert!(ran.records().contains(&format!("self test: {why}")), "{why}");
    }
}

#[test]
fn a_brown_out_is_reported_and_its_cause_stays_in_a_register() {
    let requests = [(1_500, ACCESS_PORT, access("slipsense.status.restart", &[0]))];
    let start = Start { cause: ResetCause::BrownOut, crash: None };
    let ran = Run { start, ..Run::new(&requests, 3_000) }.run();
    assert_eq!(ran.records()[0], "restarted after a brown-out");
    let (_, _, answer) = &ran.answers(ACCESS_PORT)[0];
    assert_eq!(answer[10..14], 2u32.to_le_bytes());
}

#[test]
fn a_failed_self_check_is_recorded_once_and_is_in_every_heartbeat() {
    let register = access("slipsense.status.self_checks", &[0]);
    let requests = [(100, COMMAND_PORT, command(SELF_TEST, b"")), (1_500, ACCESS_PORT, register)];
    let found = with_status(|ms, status| {
        status.decided_frames = decided(ms);
        status.self_checks = SelfChecks { passes: 2, inferences: 1, failed: 9 };
    });
    let ran = Run { meanwhile: &found, ..Run::new(&requests, 3_000) }.run();
    let records: Vec<_> =
        ran.records().into_iter().filter(|record| record.starts_with("self check")).collect();
    assert_eq!(records, ["self check failed: the model in RAM", "self check failed: the golden inference"]);
    assert_eq!(ran.answers(COMMAND_PORT)[0].2[0], 1, "self test");
    let numbers = [2u32, 1, 9].map(u32::to_le_bytes);
    assert_eq!(ran.answers(ACCESS_PORT)[0].2[10..22], *numbers.as_flattened());
    // A warning; no decision to be believed, and the stuck taxel.
    let beat = &ran.messages(HEARTBEAT_PORT)[1].2;
    assert_eq!((beat[4], beat[6]), (3, 2 | 128));
    assert_eq!(ran.log.shown.last(), Some(&Condition::Warning));
}

#[test]
fn a_board_without_arrays_calibrates_none() {
    let ran = Run::new(&[(100, COMMAND_PORT, command(CALIBRATE, b"0 1"))], 1_500).run();
    let why = "there is no array";
    let answer = &ran.answers(COMMAND_PORT)[0].2;
    assert_eq!((answer[0], &answer[2..2 + why.len()]), (1, why.as_bytes()));
    assert!(!ran.records().iter().any(|record| record.contains("calibrated")), "{:?}", ran.records());
}

/// Each second, and at once where it changes.
#[test]
fn the_light_shows_the_condition() {
    let found = with_status(|ms, status| {
        status.decided_frames = decided(ms);
        status.self_checks.failed = u8::from(ms >= 1_500);
    });
    let ran = Run { meanwhile: &found, ..Run::new(&[], 3_000) }.run();
    let (nominal, warning) = (Condition::Nominal, Condition::Warning);
    assert_eq!(ran.log.shown, [nominal, nominal, warning, warning]);
}

#[test]
fn a_panic_is_told_once_and_stays_in_its_register() {
    let panic = CrashRecord::new(None, "index out of bounds", "src/tasks/infer.rs", 77);
    let requests = [(1_500, ACCESS_PORT, access("slipsense.status.last_panic", &[0]))];
    let start = Start { crash: Some(panic), ..Start::default() };
    let ran = Run { start, ..Run::new(&requests, 3_000) }.run();
    let log: Vec<_> = ran.records().into_iter().filter(|record| record.contains("restarted after")).collect();
    assert_eq!(log, [format!("restarted after {panic}")]);
    let answer = &ran.answers(ACCESS_PORT)[0].2;
    assert_eq!(answer[10..14], panic.reason_hash.to_le_bytes());
    // Health and vendor status of the heartbeat: caution, panicked, and the stuck taxel.
    let beat = &ran.messages(HEARTBEAT_PORT)[1].2;
    assert_eq!((beat[4], beat[6]), (2, 32 | 128));
}
