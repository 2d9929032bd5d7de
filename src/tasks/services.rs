//! The services on the bus: the node between what arrives, what the tasks know and what the board can do.
//!
//! ```text
//! CanReceive ─> Node ─> Shared (bounded) ─> Transmission
//!      settings ─> RuntimeConfig ─> Inference    actions ─> ServiceBoard
//! ```
//!
//! Nothing here waits for the bus: frames for which [`Shared`] has no room stay in the node's own queue, which drops
//! whole transfers and counts them. What takes the board long goes on beside the node, which answers meanwhile.
#![allow(async_fn_in_trait, reason = "tasks are spawned with concrete types, which decide about Send")]

use core::future::{Future, poll_fn};
use core::pin::pin;
use core::task::Poll;

use embassy_futures::select::{Either, select};
use embassy_futures::yield_now;
use embassy_sync::blocking_mutex::raw::RawMutex;

use super::{RuntimeConfig, SERVICE_FRAMES, Shared, Task};
use crate::board::crash_record::{CrashRecord, ResetCause, Start};
use crate::board::{CanReceive, Clock, StatusLed};
use crate::calibration::{Request, Summary};
use crate::drivers::Failure;
use crate::health::{self, CanState, Condition, SELF_CHECKS, Status};
use crate::node::{
    Action, CALIBRATION_LINE, CHALLENGE_BYTES, FileSink, Node, SIGNATURE_BYTES, Severity, UpdateTarget,
};
use crate::params::{FRAME_PERIOD_US, FRAME_RATE_HZ};
use crate::settings::Settings;
use crate::update::{Evidence, Notice};
use crate::wire::NodeId;

/// The task moves on at least this often, µs: five times within the watchdog's period.
const POLL_US: u64 = 20_000;
/// The same while frames wait for room.
const POLL_FAST_US: u64 = 1_000;
/// Longest wait of work for a frame that leaves time: one late frame in 25 is less bad than a store that never ends.
const STARVED_US: u64 = 25 * FRAME_PERIOD_US;
/// How long a restart waits for its answer to leave at most, µs.
const RESTART_TIMEOUT_US: u64 = 100_000;
/// For the frame that the hardware holds when all others have gone, µs: dozens of the longest frames.
const LAST_FRAME_US: u64 = 10_000;
/// A self test looks at the sensors for so long, µs.
const SELF_TEST_US: u64 = 500_000;
/// Frames that must be decided meanwhile: nine of ten.
const SELF_TEST_FRAMES: u32 = FRAME_RATE_HZ / 2 * 9 / 10;
/// How long the light blinks for [`Action::Identify`], and how long it is on or off, µs.
const IDENTIFY_US: u64 = 5_000_000;
const BLINK_US: u64 = 125_000;
/// How often the node says by which calibration its arrays are read, µs: so a recording of some seconds knows.
const CALIBRATIONS_US: u64 = 10_000_000;
/// The LED gets the node's status at least this often, µs.
const SHOW_US: u64 = 1_000_000;

/// What the services need of a board beside the bus. What fails says why, in words for the bus.
pub trait ServiceBoard: FileSink + StatusLed {
    /// Put the settings away so that the next start finds them.
    async fn store(&mut self, settings: &Settings) -> Result<(), &'static str>;

    /// Make room for a file; the bytes it may have at most.
    async fn begin_update(&mut self, target: UpdateTarget) -> Result<u32, &'static str>;

    /// These settings count from now on: what of them is the drivers'. Called at the start and after every change.
    fn apply(&mut self, settings: &Settings);

    /// Add what the drivers know and [`Shared`] does not.
    fn observe(&mut self, status: &mut Status);

    /// Switch the light by which a person finds this board; [`StatusLed::show`] follows when it is over.
    fn identify(&mut self, lit: bool);

    /// What the board has to say without being asked, the next line of it. Asked for while the node has an address
    /// and nothing else to say.
    fn next_notice(&mut self) -> Option<Notice> {
        None
    }

    /// `true`: that is enough for a new firmware to be kept, [`confirm`](Self::confirm) now. Asked for again and
    /// again.
    fn ready_to_confirm(&mut self, _evidence: Evidence) -> bool {
        false
    }

    /// Keep the firmware that runs. How that went, a notice says.
    async fn confirm(&mut self) {}

    /// Is this the signature of [`UNLOCK_PREFIX`](crate::node::UNLOCK_PREFIX) and the challenge by an update key?
    fn unlocks(&mut self, challenge: &[u8; CHALLENGE_BYTES], signature: &[u8; SIGNATURE_BYTES]) -> bool;

    /// Measure an array, or change its calibration: begun when this returns.
    fn calibrate(&mut self, _request: Request) -> Result<(), &'static str> {
        Err("there is no array")
    }

    /// Is there something to [`end_calibration`](Self::end_calibration)? Asked for again and again.
    fn calibration_ends(&mut self) -> bool {
        false
    }

    /// Make the new calibration, store it, apply it: of which array, and how it went.
    async fn end_calibration(&mut self) -> Option<(u8, Result<Summary, Failure>)> {
        None
    }
}

/// Judge a self test by what the tasks counted before and after it: did frames come, and does every sensor deliver both
/// parts?
fn self_test(before: &Status, after: &Status) -> Result<(), &'static str> {
    let frames = after.decided_frames.wrapping_sub(before.decided_frames);
    let faults = [
        // Without a model no frame is decided.
        (after.any_sensor(health::NO_MODEL), "self test: no readable model"),
        (frames < SELF_TEST_FRAMES, "self test: frames are missing"),
        (after.any_sensor(health::PIEZO_MISSING), "self test: an array does not deliver"),
        (after.any_sensor(health::XL_MISSING), "self test: an accelerometer does not deliver"),
        (after.self_checks.failed != 0, "self test: code, model or network is not what it was at start"),
        (after.frozen, "self test: an accelerometer is frozen"),
    ];
    faults.into_iter().find(|(is_there, _)| *is_there).map_or(Ok(()), |(_, why)| Err(why))
}

/// The services task.
pub struct Services<'a, M: RawMutex, R, C, B> {
    node_loop: NodeLoop<'a, M, R, C>,
    /// The board.
    pub board: B,
    shown: Option<(Condition, u64)>,
    identify_until_us: u64,
    restart_at_us: Option<u64>,
}

/// The node and whom it talks to; apart from the board, which may be at work meanwhile.
struct NodeLoop<'a, M: RawMutex, R, C> {
    node: Node,
    bus: R,
    clock: C,
    shared: &'a Shared<M>,
    /// The address that filters and controls are set for; `None` before the first time.
    address: Option<Option<NodeId>>,
    start: Start,
    /// The crash before the start, until it has been reported.
    crash: Option<CrashRecord>,
    was_off: bool,
    next_us: u64,
    /// When the calibrations are told next.
    calibrations_us: u64,
    /// Heartbeats handed over to transmission, without those that another one replaced.
    heartbeats: u32,
    /// Failed checks that have been reported.
    reported: u8,
}

impl<'a, M: RawMutex, R: CanReceive, C: Clock + Clone, B: ServiceBoard> Services<'a, M, R, C, B> {
    /// Before the first frame. `start`: how the board came to start.
    pub fn new(node: Node, bus: R, clock: C, shared: &'a Shared<M>, board: B, start: Start) -> Self {
        let node_loop = NodeLoop {
            node,
            bus,
            clock,
            shared,
            address: None,
            start,
            crash: start.crash,
            was_off: false,
            next_us: 0,
            calibrations_us: 0,
            heartbeats: 0,
            reported: 0,
        };
        Self { node_loop, board, shown: None, identify_until_us: 0, restart_at_us: None }
    }

    /// Serve until the board is to start anew, which is the caller's to do.
    pub async fn run(&mut self) {
        let (start, sensors) = (self.node_loop.start, self.node_loop.node.settings().sensors());
        self.node_loop.shared.update_status(|status| {
            status.last_panic = start.crash.map_or(0, |record| record.reason_hash.max(1));
            status.restart = start.numbers();
            // Another number counts after the next start.
            status.sensors = sensors;
        });
        self.board.apply(self.node_loop.node.settings());
        self.node_loop.node.set_operational();
        while self.restart_at_us.is_none_or(|at| self.node_loop.clock.now_us() < at) {
            self.serve().await;
        }
    }

    async fn serve(&mut self) {
        self.node_loop.shared.update_status(|status| self.board.observe(status));
        self.node_loop.poll();
        self.update_led();
        self.apply_changes();
        self.publish_notice();
        if self.board.ready_to_confirm(self.node_loop.evidence()) {
            self.node_loop.meanwhile(self.board.confirm()).await;
        }
        if self.board.calibration_ends()
            && let Some((sensor, result)) = self.node_loop.meanwhile(self.board.end_calibration()).await
        {
            match result {
                // With the lines that say so again and again.
                Ok(_) => self.node_loop.calibrations_us = 0,
                Err(why) => {
                    let line = format_args!("sensor {sensor} not calibrated: {why}");
                    self.node_loop.node.report(Severity::Error, line);
                }
            }
        }
        if let Some(action) = self.node_loop.node.take_action() {
            self.act(action).await;
        } else if let Some(chunk) = self.node_loop.node.take_chunk() {
            let result = self.node_loop.meanwhile(chunk.deliver(&mut self.board)).await;
            self.node_loop.node.chunk_done(&chunk, result);
        } else {
            self.shorten_restart();
            self.node_loop.receive(if self.restart_at_us.is_some() { POLL_FAST_US } else { POLL_US }).await;
        }
    }

    /// A restart need not wait once all has been said.
    fn shorten_restart(&mut self) {
        if let Some(at) = &mut self.restart_at_us
            && self.node_loop.is_drained()
        {
            *at = (*at).min(self.node_loop.clock.now_us().saturating_add(LAST_FRAME_US));
        }
    }

    async fn act(&mut self, action: Action) {
        let now_us = self.node_loop.clock.now_us();
        match action {
            Action::Restart => self.restart_at_us = Some(now_us.saturating_add(RESTART_TIMEOUT_US)),
            Action::Identify => self.identify_until_us = now_us.saturating_add(IDENTIFY_US),
            Action::Store | Action::FactoryReset => {
                let settings = self.node_loop.node.settings().clone();
                let result = self.node_loop.meanwhile(self.board.store(&settings)).await;
                self.node_loop.node.command_done(result);
            }
            Action::SelfTest => {
                let before = self.node_loop.shared.status();
                self.node_loop.pause(SELF_TEST_US).await;
                let result = self_test(&before, &self.node_loop.shared.status());
                self.node_loop.shared.update_status(|status| {
                    status.self_tests = status.self_tests.saturating_add(1);
                    status.failed_self_tests =
                        status.failed_self_tests.saturating_add(result.is_err().into());
                });
                self.node_loop.node.command_done(result);
            }
            Action::Unlock(signature) => {
                let challenge = self.node_loop.node.challenge();
                let board = &mut self.board;
                let check =
                    async { challenge.is_some_and(|challenge| board.unlocks(&challenge, &signature)) };
                let valid = self.node_loop.meanwhile(check).await;
                self.node_loop.node.unlock_done(valid);
                self.node_loop.apply_config();
            }
            Action::Calibrate(request) => {
                let result = self.board.calibrate(request);
                self.node_loop.node.command_done(result);
            }
            Action::BeginUpdate { target, file } => {
                match self.node_loop.meanwhile(self.board.begin_update(target)).await {
                    Ok(length_max) => self.node_loop.node.begin_download(target, file, length_max),
                    Err(why) => {
                        let name = target.name();
                        self.node_loop.node.report(Severity::Error, format_args!("{name} not taken: {why}"));
                    }
                }
            }
            // Whoever sent it restarts the board; why it was given up, the node has said.
            Action::UpdateReceived { .. } | Action::UpdateFailed { .. } => {}
        }
    }

    fn apply_changes(&mut self) {
        let mut any = false;
        while let Some(setting) = self.node_loop.node.take_changed() {
            any = true;
            let name = setting.definition().name;
            self.node_loop.node.report(Severity::Debug, format_args!("{name} changed"));
        }
        if any {
            self.node_loop.apply_config();
            self.board.apply(self.node_loop.node.settings());
        }
    }

    /// One line at a time: the queue is for answers.
    fn publish_notice(&mut self) {
        if self.node_loop.node.node_id().is_some()
            && self.node_loop.node.is_drained()
            && let Some(notice) = self.board.next_notice()
        {
            self.node_loop.node.report(notice.severity(), format_args!("{notice}"));
        }
    }

    fn update_led(&mut self) {
        let now_us = self.node_loop.clock.now_us();
        if now_us < self.identify_until_us {
            self.shown = None;
            self.board.identify(((self.identify_until_us - now_us) / BLINK_US).is_multiple_of(2));
            return;
        }
        let condition = self.node_loop.node.status.condition();
        let is_due = self.shown.is_none_or(|(before, at)| before != condition || now_us >= at);
        if is_due {
            self.shown = Some((condition, now_us.saturating_add(SHOW_US)));
            self.board.show(condition);
        }
    }
}

impl<M: RawMutex, R: CanReceive, C: Clock + Clone> NodeLoop<'_, M, R, C> {
    /// Whatever takes no time.
    fn poll(&mut self) {
        self.shared.progress.made(Task::Services);
        self.update_status();
        self.next_us = self.node.poll(self.clock.now_us());
        if self.address != Some(self.node.node_id()) {
            self.address = Some(self.node.node_id());
            self.bus.accept_only(&self.node.filters());
            self.apply_config();
        }
        if self.node.node_id().is_some() {
            self.report();
        }
        if let Some(frame) = self.node.take_heartbeat()
            && self.shared.send_heartbeat(frame)
        {
            self.heartbeats = self.heartbeats.saturating_add(1);
        }
        while self.shared.service_room() > 0 {
            let Some(frame) = self.node.next_frame() else { break };
            self.shared.send_service(frame);
        }
    }

    /// What the node says of itself, once it has an address.
    fn report(&mut self) {
        if let Some(record) = &self.crash
            && self.node.try_report(Severity::Critical, format_args!("restarted after {record}"))
        {
            self.crash = None;
        }
        if self.start.cause == ResetCause::BrownOut
            && self.node.try_report(Severity::Critical, format_args!("restarted after a brown-out"))
        {
            self.start.cause = ResetCause::default();
        }
        let failed = self.node.status.self_checks.failed & !self.reported;
        for (bit, what) in SELF_CHECKS.iter().enumerate().filter(|(bit, _)| failed >> bit & 1 != 0) {
            if self.node.try_report(Severity::Alert, format_args!("self check failed: {what}")) {
                self.reported |= 1 << bit;
            }
        }
        if self.clock.now_us() >= self.calibrations_us && self.node.is_drained() {
            self.calibrations_us = self.clock.now_us().saturating_add(CALIBRATIONS_US);
            let Status { sensors, calibrations, .. } = self.node.status;
            for (sensor, summary) in calibrations.iter().enumerate().take(sensors) {
                self.node.report(Severity::Info, format_args!("{CALIBRATION_LINE} {sensor}: {summary}"));
            }
        }
    }

    fn evidence(&self) -> Evidence {
        let status = self.shared.status();
        Evidence {
            frames: status.decided_frames,
            // One may wait, and one be in the hardware; what was taken back from there nobody got.
            heartbeats: self.heartbeats.saturating_sub(status.lost_services.saturating_add(2)),
            requests: self.node.served_requests(),
            senses: !status.no_sensor_left() && status.self_checks.failed == 0,
        }
    }

    fn update_status(&mut self) {
        self.node.status = self.shared.status();
        let is_off = self.node.status.can.state == CanState::BusOff;
        if is_off && !core::mem::replace(&mut self.was_off, is_off) {
            // Nobody waits for these answers any more when the bus is back.
            self.node.discard_frames();
        }
        self.was_off = is_off;
    }

    /// Settings that the other tasks look at.
    fn apply_config(&self) {
        let Self { node, shared, .. } = self;
        shared.set_config(RuntimeConfig::new(node.settings(), node.node_id(), node.is_locked()));
    }

    /// Has everything gone, but for a frame that the hardware may hold?
    fn is_drained(&self) -> bool {
        self.node.is_drained() && self.shared.service_room() == SERVICE_FRAMES
    }

    /// Take the next frame in, if one comes before something is due.
    async fn receive(&mut self, timeout_us: u64) {
        let timeout_us = if self.node.is_drained() { timeout_us } else { timeout_us.min(POLL_FAST_US) };
        let now_us = self.clock.now_us();
        // What is due already had its turn.
        let until_us =
            self.next_us.clamp(now_us.saturating_add(POLL_FAST_US), now_us.saturating_add(timeout_us));
        if let Some((frame, at_us)) = self.bus.receive(until_us).await {
            self.node.accept(&frame, at_us);
            // A bus full of requests must not keep the other tasks of this executor from running.
            yield_now().await;
        }
    }

    /// Serve beside this work until it is done. It goes on while the next frame has time: the check of a signature takes
    /// nearly a frame's, and decisions wait for it. Where no frame leaves time, it goes on every [`STARVED_US`].
    async fn meanwhile<T>(&mut self, work: impl Future<Output = T>) -> T {
        let mut work = pin!(work);
        let mut polled_us = self.clock.now_us();
        loop {
            self.poll();
            let (shared, clock, polled_us) = (self.shared, self.clock.clone(), &mut polled_us);
            let in_time = poll_fn(|context| {
                let now_us = clock.now_us();
                if !shared.has_time(now_us) && now_us.saturating_sub(*polled_us) < STARVED_US {
                    return Poll::Pending;
                }
                *polled_us = now_us;
                work.as_mut().poll(context)
            });
            match select(in_time, self.receive(POLL_FAST_US)).await {
                Either::First(done) => return done,
                Either::Second(()) => {}
            }
        }
    }

    /// Serve for so long.
    async fn pause(&mut self, us: u64) {
        let until_us = self.clock.now_us().saturating_add(us);
        while self.clock.now_us() < until_us {
            self.poll();
            self.receive(POLL_US).await;
        }
    }
}
