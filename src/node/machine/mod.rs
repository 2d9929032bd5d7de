//! The node itself: which frame goes to which service, and what is due when.

mod serve;
mod update;

use core::fmt;

use super::action::Action;
use super::allocation::{ALLOCATION_PORT, Allocation};
use super::command::{COMMAND_PORT, CommandStatus};
use super::counters::Counters;
use super::diagnostic::{self, RECORD_BYTES, RECORD_PORT, Severity};
use super::file_read::{FILE_READ_PORT, FileRead};
use super::get_info::GET_INFO_PORT;
use super::heartbeat::{self, HEARTBEAT_PERIOD_US, HEARTBEAT_PORT, Mode, vendor_status};
use super::identity::Identity;
use super::lock::{CHALLENGE_BYTES, Lock};
use super::outbox::Outbox;
use super::registers::{ACCESS_PORT, LIST_PORT};
use super::time_sync::{TIME_PORT, TimeSync};
use crate::health::{Condition, Status, bits_if};
use crate::settings::{Setting, Settings};
use crate::wire::{
    CanFrame, FRAME_PAYLOAD, Frames, MessageId, NodeId, Priority, ServiceId, ServiceRole, Sessions,
    TransferId, next_transfer,
};

/// Senders whose transfers are put together at a time.
const SESSIONS: usize = 6;
/// Bytes of the longest transfer that is received, with padding and CRC: an Access request with the longest
/// name and value.
const TRANSFER_MAX: usize = (1 + 255 + 1 + 2 + 256 + 2_usize).div_ceil(FRAME_PAYLOAD) * FRAME_PAYLOAD;
/// Time that the board has for a command that is answered when it is done, µs. An erase of a flash sector
/// takes up to 4 s (STM32H743 data sheet, flash memory programming).
pub const COMMAND_TIMEOUT_US: u64 = 8_000_000;
/// Time after an update that was not finished, or a signature that the board refused, in which none is looked at, µs:
/// checking a signature takes milliseconds, an erase wears the flash, and nobody must have them one after the other.
pub const SIGNATURE_PAUSE_US: u64 = 1_000_000;

/// Time after a store in which there is no other, µs, and so with calibrations: whoever floods the bus with them must not
/// wear the flash out. A restart, which takes longer than a store, ends it.
pub const STORE_PAUSE_US: u64 = 10_000_000;

/// A command that is answered when the board says how it went.
#[derive(Clone, Copy, Debug)]
struct Pending {
    id: ServiceId,
    transfer: u8,
    deadline_us: u64,
    /// It was answered that the board did not finish in time: what the board says later answers no other command.
    is_overdue: bool,
}

/// Transfer identifiers of what the node sends by itself.
#[derive(Clone, Debug, Default)]
struct TransferIds {
    heartbeat: u8,
    record: u8,
    file: u8,
}

/// A node of a Cyphal bus, without bus and clock. All times are microseconds of the board's clock, which
/// starts at 0 and never goes back.
#[derive(Clone, Debug)]
pub struct Node {
    identity: Identity,
    settings: Settings,
    /// How the board is; filled by the tasks whenever they like.
    pub status: Status,
    id: Option<NodeId>,
    sessions: Sessions<SESSIONS, TRANSFER_MAX>,
    outbox: Outbox,
    /// Until somebody takes it, or the next one comes.
    heartbeat: Option<CanFrame>,
    counters: Counters,
    transfers: TransferIds,
    allocation: Allocation,
    time: TimeSync,
    heartbeat_us: u64,
    now_us: u64,
    operational: bool,
    /// Has what happened before the start been reported?
    announced: bool,
    pending: Option<Pending>,
    actions: heapless::Deque<Action, 4>,
    /// Bit n: setting number n has a new value that nobody has taken note of.
    changed: u32,
    file: Option<FileRead>,
    files: u32,
    lock: Lock,
    /// No signature is checked before this time: the board refused one, or an update was not finished.
    signature_pause_until_us: u64,
    /// Nothing is stored before this time; no array is calibrated before the other.
    store_pauses_until_us: [u64; 2],
    /// Requests served since start.
    served: u32,
}

impl Node {
    /// A node with settings as they were loaded. Its address is the one that is set.
    pub fn new(identity: Identity, settings: Settings) -> Self {
        let lock = Lock::new(settings.is_on(Setting::Lock), identity.entropy);
        Self {
            allocation: Allocation::new(identity.unique_id),
            id: settings.node_id(),
            identity,
            settings,
            status: Status::new(),
            sessions: Sessions::new(),
            outbox: Outbox::default(),
            heartbeat: None,
            counters: Counters::default(),
            transfers: TransferIds::default(),
            time: TimeSync::default(),
            heartbeat_us: 0,
            now_us: 0,
            operational: false,
            announced: false,
            pending: None,
            actions: heapless::Deque::new(),
            changed: 0,
            file: None,
            files: 0,
            lock,
            signature_pause_until_us: 0,
            store_pauses_until_us: [0; 2],
            served: 0,
        }
    }

    /// The settings in force.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// What the node is.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// The node's address; `None`: it has none yet, and may send nothing but its request for one.
    pub fn node_id(&self) -> Option<NodeId> {
        self.id
    }

    /// What the node's own traffic met with.
    pub fn counters(&self) -> Counters {
        let transfer_errors = self.counters.transfer_errors.saturating_add(self.sessions.displaced);
        Counters { transfer_errors, dropped_transfers: self.outbox.dropped, ..self.counters }
    }

    /// Does the node refuse what would change it?
    pub fn is_locked(&self) -> bool {
        self.lock.is_closed()
    }

    /// What must be signed to unlock; `None`: the board has no random number, and stays locked.
    pub fn challenge(&self) -> Option<[u8; CHALLENGE_BYTES]> {
        self.lock.challenge(&self.identity.unique_id)
    }

    /// Requests served since start: a node that served one receives.
    pub fn served_requests(&self) -> u32 {
        self.served
    }

    /// The tasks are running: from now on the heartbeat says so.
    pub fn set_operational(&mut self) {
        self.operational = true;
    }

    /// Bus time at a moment of the local clock; `None` where no master was received, or the node does not follow.
    pub fn bus_time_us(&self, local_us: u64) -> Option<u64> {
        let offset = self.time.offset_us.filter(|_| self.settings.is_on(Setting::TimeSync))?;
        local_us.checked_add_signed(offset)
    }

    /// How well the board is.
    pub fn health(&self) -> Condition {
        heartbeat::health(&self.status, self.flags())
    }

    /// What the board is doing.
    pub fn mode(&self) -> Mode {
        match (&self.file, self.operational) {
            (Some(_), _) => Mode::SoftwareUpdate,
            (None, true) => Mode::Operational,
            (None, false) => Mode::Initialization,
        }
    }

    fn flags(&self) -> u8 {
        heartbeat::flags(&self.status)
            | bits_if(self.identity.settings.is_damaged(), vendor_status::SETTINGS_DAMAGED)
            | bits_if(self.identity.model_hash.is_none(), vendor_status::NO_DECISION)
    }

    /// The heartbeat, if one is due: it overtakes all other frames, so that whoever fills the bus does not silence it.
    pub fn take_heartbeat(&mut self) -> Option<CanFrame> {
        self.heartbeat.take()
    }

    /// The next frame for the bus, a heartbeat first. Frames of equal identifier must stay in order.
    pub fn next_frame(&mut self) -> Option<CanFrame> {
        self.take_heartbeat().or_else(|| self.outbox.pop())
    }

    /// Forget the frames that nobody has taken, and count their transfers as dropped: after a time without a
    /// bus they are old news.
    pub fn discard_frames(&mut self) {
        self.outbox.discard(self.heartbeat.take().is_some());
    }

    /// Has every frame been taken?
    pub fn is_drained(&self) -> bool {
        self.outbox.is_empty() && self.heartbeat.is_none()
    }

    /// The next thing that the board must do.
    pub fn take_action(&mut self) -> Option<Action> {
        self.actions.pop_front()
    }

    /// A setting with a new value since the last call. Those that count after a restart are among them.
    pub fn take_changed(&mut self) -> Option<Setting> {
        let number = self.changed.trailing_zeros();
        self.changed &= self.changed.wrapping_sub(1);
        u8::try_from(number).ok().and_then(Setting::from_number)
    }

    /// Do what is due. Returns when it is to be called again at the latest; after [`accept`](Self::accept)
    /// and every answer of the board it may be sooner, so call it after those too.
    pub fn poll(&mut self, now_us: u64) -> u64 {
        self.now_us = self.now_us.max(now_us);
        let Some(id) = self.id else { return self.poll_allocation(now_us) };
        if !self.announced {
            self.announced = true;
            if self.identity.settings.is_damaged() {
                let report = self.identity.settings;
                self.report(Severity::Warning, format_args!("{report}"));
            }
        }
        if now_us >= self.heartbeat_us {
            // After a long silence one heartbeat, not all that were missed.
            let next = self.heartbeat_us.saturating_add(HEARTBEAT_PERIOD_US);
            self.heartbeat_us = if next > now_us { next } else { now_us.saturating_add(HEARTBEAT_PERIOD_US) };
            let uptime_s = u32::try_from(now_us / 1_000_000).unwrap_or(u32::MAX);
            let payload = heartbeat::encode(uptime_s, self.health(), self.mode(), self.flags());
            let message = MessageId { priority: Priority::Nominal, port: HEARTBEAT_PORT, node: id };
            let transfer = next_transfer(&mut self.transfers.heartbeat);
            self.heartbeat = Some(CanFrame::single(message, transfer, &payload));
        }
        let mut next_us = self.heartbeat_us;
        if let Some(pending) = self.pending.filter(|pending| !pending.is_overdue) {
            if now_us >= pending.deadline_us {
                let why = "the board did not finish in time";
                self.answer(pending.id, pending.transfer, CommandStatus::Failure, why);
                self.pending = Some(Pending { is_overdue: true, ..pending });
            } else {
                next_us = next_us.min(pending.deadline_us);
            }
        }
        next_us.min(self.poll_file(id, now_us))
    }

    fn poll_allocation(&mut self, now_us: u64) -> u64 {
        if !self.settings.is_on(Setting::PlugAndPlay) {
            return now_us.saturating_add(HEARTBEAT_PERIOD_US);
        }
        if let Some((id, payload)) = self.allocation.poll(now_us) {
            self.outbox.push(Frames::new(id, next_transfer(&mut self.allocation.transfer), &payload));
        }
        self.allocation.next_us.unwrap_or(now_us)
    }

    /// What a controller's acceptance filters let through, so that the raw frames of others stay away: pairs of identifier
    /// and mask, a frame passes if `id & mask == identifier` for one of them. They change with the address alone.
    pub fn filters(&self) -> heapless::Vec<(u32, u32), 4> {
        const SERVICE: u32 = 1 << 25;
        const ANONYMOUS: u32 = 1 << 24;
        const PORT: u32 = 0x1FFF << 8;
        const NODE: u32 = 0x7F;
        let subject = |port: u16| (u32::from(port) << 8, SERVICE | ANONYMOUS | PORT);
        let time = subject(TIME_PORT);
        let filters = match self.id.map(|id| u32::from(id.get())) {
            None => heapless::Vec::from_slice(&[time, subject(ALLOCATION_PORT)]),
            Some(id) => {
                let same_address = (id, SERVICE | ANONYMOUS | NODE);
                heapless::Vec::from_slice(&[time, (SERVICE | id << 7, SERVICE | NODE << 7), same_address])
            }
        };
        // There is room for four.
        filters.unwrap_or_default()
    }

    /// Take a frame of the bus that arrived at `now_us`, as exactly as the board knows: the bus time is as
    /// exact. Frames that are not for this node are passed over.
    pub fn accept(&mut self, frame: &CanFrame, now_us: u64) {
        self.now_us = self.now_us.max(now_us);
        let Ok(id) = TransferId::from_can(frame.id()) else {
            self.counters.foreign_frames = self.counters.foreign_frames.saturating_add(1);
            return;
        };
        if self.is_own(id) {
            // A controller does not receive what it sends: somebody else has this address.
            self.counters.address_conflicts = self.counters.address_conflicts.saturating_add(1);
            // Again and again, ever more rarely: a report may find no room.
            if self.counters.address_conflicts.is_power_of_two() {
                self.report(Severity::Critical, format_args!("another node has this address"));
            }
            return;
        }
        if !self.wants(id) {
            return;
        }
        // The transfer is copied out of its session, so that serving it may use the whole node.
        let mut payload = heapless::Vec::<u8, TRANSFER_MAX>::new();
        let transfer = match self.sessions.accept(id, frame, now_us) {
            Ok(Some(arrived)) => {
                // There is room: a session holds no more.
                let _ = payload.extend_from_slice(arrived.payload);
                arrived.transfer
            }
            Ok(None) => return,
            Err(_) => {
                self.counters.transfer_errors = self.counters.transfer_errors.saturating_add(1);
                return;
            }
        };
        match id {
            TransferId::Message(message) if message.port == TIME_PORT => {
                self.time.accept(message.node, transfer, &payload, now_us);
            }
            TransferId::Message(_) => {
                if let Some(allocated) = self.allocation.accept(&payload) {
                    self.id = Some(allocated);
                    self.heartbeat_us = now_us;
                    self.report(Severity::Info, format_args!("address {} allocated", allocated.get()));
                }
            }
            TransferId::Service(service) if service.role == ServiceRole::Response => {
                let Some(file) = &mut self.file else { return };
                if let Err(failure) = file.accept(service.source, transfer, &payload) {
                    self.give_up(failure);
                }
            }
            TransferId::Service(service) => self.serve(service, transfer, &payload),
            TransferId::Anonymous(_) => {}
        }
    }

    /// Is it a message with this node's own address? Every node sends messages: the heartbeat.
    fn is_own(&self, id: TransferId) -> bool {
        matches!(id, TransferId::Message(id) if self.id == Some(id.node))
    }

    /// Is a frame of this identifier for this node?
    fn wants(&self, id: TransferId) -> bool {
        match id {
            TransferId::Message(id) => match id.port {
                TIME_PORT => self.settings.is_on(Setting::TimeSync),
                ALLOCATION_PORT => self.id.is_none() && self.settings.is_on(Setting::PlugAndPlay),
                _ => false,
            },
            TransferId::Service(id) if self.id == Some(id.destination) => match id.role {
                ServiceRole::Request => {
                    matches!(id.port, GET_INFO_PORT | COMMAND_PORT | ACCESS_PORT | LIST_PORT)
                }
                ServiceRole::Response => id.port == FILE_READ_PORT && self.file.is_some(),
            },
            _ => false,
        }
    }

    /// Say something to whoever watches the bus. Dropped and counted while the queue is more than half full: answers
    /// come first.
    pub fn report(&mut self, severity: Severity, text: fmt::Arguments<'_>) {
        if !self.try_report(severity, text) && self.id.is_some() {
            self.outbox.dropped = self.outbox.dropped.saturating_add(1);
        }
    }

    /// The same for what is tried again: not counted. `false`: there was no room, or the node has no address.
    pub fn try_report(&mut self, severity: Severity, text: fmt::Arguments<'_>) -> bool {
        let Some(node) = self.id.filter(|_| self.outbox.is_half_free()) else { return false };
        let mut out = [0; RECORD_BYTES];
        let time = self.bus_time_us(self.now_us).unwrap_or(0);
        let length = diagnostic::encode(time, severity, text, &mut out);
        let message = MessageId { priority: Priority::Optional, port: RECORD_PORT, node };
        let transfer = next_transfer(&mut self.transfers.record);
        self.outbox.push(Frames::new(message, transfer, out.get(..length).unwrap_or(&[])));
        true
    }
}
