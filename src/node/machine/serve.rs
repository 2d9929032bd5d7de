//! Requests of other nodes and their answers.

use super::super::action::Action;
use super::super::command::{self, CommandStatus};
use super::super::diagnostic::Severity;
use super::super::file_read::{FileFailure, FileRead};
use super::super::get_info::{self, GET_INFO_BYTES, GET_INFO_PORT};
use super::super::registers::{self, ACCESS_BYTES, ACCESS_PORT, Effect, LIST_BYTES, LIST_PORT, NodeState};
use super::{COMMAND_TIMEOUT_US, Node, Pending, SIGNATURE_PAUSE_US, STORE_PAUSE_US};
use crate::settings::Settings;
use crate::wire::{Frames, ServiceId};

/// Why nothing changes.
const LOCKED: &str = "locked, see slipsense.lock";

impl Node {
    pub(super) fn serve(&mut self, id: ServiceId, transfer: u8, request: &[u8]) {
        self.served = self.served.saturating_add(1);
        match id.port {
            GET_INFO_PORT => {
                let mut out = [0; GET_INFO_BYTES];
                let length = get_info::encode(&self.identity, &mut out);
                self.respond(id, transfer, out.get(..length));
            }
            LIST_PORT => {
                let mut out = [0; LIST_BYTES];
                let length = registers::list(request, &mut out);
                self.respond(id, transfer, out.get(..length));
            }
            ACCESS_PORT => self.serve_access(id, transfer, request),
            _ => self.serve_command(id, transfer, request),
        }
    }

    fn respond(&mut self, request: ServiceId, transfer: u8, payload: Option<&[u8]>) {
        self.outbox.push(Frames::new(request.response(), transfer, payload.unwrap_or(&[])));
    }

    fn serve_access(&mut self, id: ServiceId, transfer: u8, request: &[u8]) {
        let bus_time_us = self.bus_time_us(self.now_us).unwrap_or(0);
        let state = NodeState {
            status: &self.status,
            identity: &self.identity,
            uptime_s: u32::try_from(self.now_us / 1_000_000).unwrap_or(u32::MAX),
            counters: self.counters(),
            time_offset_us: self.time.offset_us,
            locked: self.lock.is_closed(),
            challenge: self.challenge(),
        };
        let mut out = [0; ACCESS_BYTES];
        let served = registers::access(request, &mut self.settings, &state, bus_time_us, &mut out);
        let Some((length, effect)) = served else {
            self.counters.transfer_errors = self.counters.transfer_errors.saturating_add(1);
            return;
        };
        self.respond(id, transfer, out.get(..length));
        match effect {
            Effect::Read => {}
            Effect::Changed(setting) => self.changed |= 1 << setting as u8,
            Effect::Locked(name) => self.report(Severity::Warning, format_args!("{name}: {LOCKED}")),
            Effect::Refused(error) => self.report(Severity::Warning, format_args!("{error}")),
            Effect::NotWritable(name) => {
                let what = "cannot be written, or not with this type";
                self.report(Severity::Warning, format_args!("{name}: {what}"));
            }
        }
    }

    fn serve_command(&mut self, id: ServiceId, transfer: u8, request: &[u8]) {
        let (status, why) = match command::decode(request, id.source) {
            Ok(action) => match self.begin(action, id, transfer) {
                // Answered when it is done.
                Ok(true) => return,
                Ok(false) => (CommandStatus::Success, ""),
                Err(why) => (CommandStatus::BadState, why),
            },
            Err(CommandStatus::BadCommand) => (CommandStatus::BadCommand, "no such command"),
            Err(status) => (status, "parameter cut short, missing or wrong"),
        };
        self.answer(id, transfer, status, why);
    }

    /// `true`: it is answered later.
    fn begin(&mut self, action: Action, id: ServiceId, transfer: u8) -> Result<bool, &'static str> {
        use Action::{Calibrate, FactoryReset, SelfTest, Store, Unlock};
        let later = matches!(action, Store | FactoryReset | SelfTest | Unlock(_) | Calibrate(_));
        if self.lock.is_closed() && !matches!(action, Action::Identify | Action::Unlock(_)) {
            return Err(LOCKED);
        }
        if later && self.pending.is_some() {
            return Err("another command is not done yet");
        }
        if matches!(action, Action::BeginUpdate { .. }) && self.file.as_ref().is_some_and(FileRead::is_ending)
        {
            return Err("the file before is being checked");
        }
        let [store, calibration] = self.store_pauses_until_us;
        let (pause_until_us, why) = match action {
            Action::BeginUpdate { .. } | Action::Unlock(_) => {
                (self.signature_pause_until_us, "wait a second after one that failed")
            }
            Action::Store | Action::FactoryReset => (store, "wait ten seconds after a store"),
            Action::Calibrate(_) => (calibration, "wait ten seconds after a calibration"),
            _ => (0, ""),
        };
        if self.now_us < pause_until_us {
            return Err(why);
        }
        // The last place is for the end of an update.
        if self.actions.len() + 1 >= self.actions.capacity() {
            return Err("too many commands at once");
        }
        let [store, calibration] = &mut self.store_pauses_until_us;
        match action {
            Action::Store | Action::FactoryReset => *store = self.now_us.saturating_add(STORE_PAUSE_US),
            Action::Calibrate(_) => *calibration = self.now_us.saturating_add(STORE_PAUSE_US),
            _ => {}
        }
        match action {
            Action::FactoryReset => {
                let defaults = Settings::new();
                for definition in &crate::settings::TABLE {
                    let setting = definition.setting;
                    let differs = self.settings.get(setting) != defaults.get(setting);
                    self.changed |= u32::from(differs) << setting as u8;
                }
                self.settings = defaults;
            }
            Action::BeginUpdate { .. } => {
                self.give_up_quietly(FileFailure::Replaced);
            }
            _ => {}
        }
        // There is room: checked above.
        let _ = self.actions.push_back(action);
        if later {
            let deadline_us = self.now_us.saturating_add(COMMAND_TIMEOUT_US);
            self.pending = Some(Pending { id, transfer, deadline_us, is_overdue: false });
        }
        Ok(later)
    }

    pub(super) fn answer(&mut self, id: ServiceId, transfer: u8, status: CommandStatus, output: &str) {
        let mut out = [0; command::RESPONSE_BYTES];
        let length = command::encode(status, output, &mut out);
        self.respond(id, transfer, out.get(..length));
    }

    pub(super) fn answer_pending(&mut self, status: CommandStatus, output: &str) {
        if let Some(pending) = self.pending.take().filter(|pending| !pending.is_overdue) {
            self.answer(pending.id, pending.transfer, status, output);
        }
    }

    /// The signature of an [`Action::Unlock`] is valid, or not.
    pub fn unlock_done(&mut self, valid: bool) {
        self.lock.tried(valid);
        if valid {
            self.report(Severity::Notice, format_args!("unlocked until the next start"));
            self.command_done(Ok(()));
        } else {
            self.signature_pause_until_us = self.now_us.saturating_add(SIGNATURE_PAUSE_US);
            self.command_done(Err("the signature does not unlock"));
        }
    }

    /// The board has done [`Action::Store`], [`Action::FactoryReset`] or [`Action::SelfTest`], or could not;
    /// the text says why, for the bus.
    pub fn command_done(&mut self, result: Result<(), &str>) {
        match result {
            Ok(()) => self.answer_pending(CommandStatus::Success, ""),
            Err(why) => {
                self.answer_pending(CommandStatus::Failure, why);
                self.report(Severity::Error, format_args!("{why}"));
            }
        }
    }
}
