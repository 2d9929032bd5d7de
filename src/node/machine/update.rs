//! A file on its way from another node to the board.

use super::super::action::Action;
use super::super::diagnostic::Severity;
use super::super::file_read::{
    self, Chunk, FILE_READ_PORT, FileFailure, FileRead, FileRef, Next, UpdateTarget,
};
use super::{Node, SIGNATURE_PAUSE_US};
use crate::wire::{Frames, NodeId, Priority, ServiceId, ServiceRole, next_transfer};

impl Node {
    /// Ask for the next piece if it is due; when to be called again.
    pub(super) fn poll_file(&mut self, id: NodeId, now_us: u64) -> u64 {
        let Some(file) = &mut self.file else { return u64::MAX };
        match file.next(now_us) {
            Next::Board => return u64::MAX,
            Next::Wait(until) => return until,
            Next::GiveUp(failure) => {
                self.give_up(failure);
                return u64::MAX;
            }
            Next::Ask => {}
        }
        let transfer = next_transfer(&mut self.transfers.file);
        let mut payload = [0; file_read::REQUEST_BYTES];
        let length = file.request(transfer, now_us, &mut payload);
        let (priority, role, port) = (Priority::Low, ServiceRole::Request, FILE_READ_PORT);
        let service = ServiceId { priority, role, port, destination: file.file.server, source: id };
        // Where the queue is full the request is lost as on a bus, and asked again.
        self.outbox.push(Frames::new(service, transfer, payload.get(..length).unwrap_or(&[])));
        now_us.saturating_add(file_read::ANSWER_TIMEOUT_US)
    }

    /// The board has made room for `length_max` bytes: ask for the file, beginning with the next
    /// [`poll`](Self::poll).
    pub fn begin_download(&mut self, target: UpdateTarget, file: FileRef, length_max: u32) {
        self.give_up_quietly(FileFailure::Replaced);
        self.files = self.files.wrapping_add(1);
        self.file = Some(FileRead::new(target, file, length_max, self.files));
    }

    /// A piece of the file that the board must put away, see [`Chunk::deliver`]; then
    /// [`chunk_done`](Self::chunk_done). The node lives on meanwhile.
    pub fn take_chunk(&mut self) -> Option<Chunk> {
        self.file.as_mut()?.take_chunk()
    }

    /// What became of a piece.
    pub fn chunk_done(&mut self, chunk: &Chunk, result: Result<(), &'static str>) {
        let Some(file) = self.file.as_mut().filter(|file| file.is_taken(chunk)) else { return };
        if let Err(why) = result {
            self.give_up(FileFailure::Refused(why));
        } else if let Some(length) = file.advance() {
            let target = file.target;
            self.file = None;
            let name = target.name();
            self.report(Severity::Notice, format_args!("{name} received and accepted, {length} bytes"));
            self.act(Action::UpdateReceived { target, length });
        }
    }

    pub(super) fn give_up(&mut self, failure: FileFailure) {
        if let Some(target) = self.give_up_quietly(failure) {
            self.act(Action::UpdateFailed { target });
        }
    }

    pub(super) fn give_up_quietly(&mut self, failure: FileFailure) -> Option<UpdateTarget> {
        let target = self.file.take()?.target;
        // What has come may have cost a signature's check and an erase.
        self.signature_pause_until_us = self.now_us.saturating_add(SIGNATURE_PAUSE_US);
        self.report(Severity::Error, format_args!("{} not taken: {failure}", target.name()));
        Some(target)
    }

    fn act(&mut self, action: Action) {
        // Commands leave the last place free, and the next update begins only when the board has taken the
        // action that asks for it: there is room.
        let _ = self.actions.push_back(action);
    }
}
