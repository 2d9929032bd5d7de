//! A node that wants of the board what it must refuse while it is locked: frame after frame, without a pause.

use std::collections::VecDeque;

use slipsense::node::{
    ACCESS_PORT, ALLOCATION_PORT, BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CALIBRATE, COMMAND_PORT,
    FACTORY_RESET, FILE_READ_PORT, GET_INFO_PORT, LIST_PORT, RESTART, SCALE_GAIN, SELF_TEST, SIGNATURE_BYTES,
    STORE, TIME_PORT, UNLOCK,
};
use slipsense::settings::TABLE;
use slipsense::wire::{CanFrame, Frames, MessageId, NodeId, Priority, ServiceId, ServiceRole};
use slipsense_can_sim::{Format, Frame, Id};

use crate::bench::mix;

const COMMANDS: [u16; 9] = [
    RESTART,
    STORE,
    FACTORY_RESET,
    SELF_TEST,
    BEGIN_SOFTWARE_UPDATE,
    BEGIN_MODEL_UPDATE,
    CALIBRATE,
    SCALE_GAIN,
    UNLOCK,
];

#[derive(Debug, Default)]
pub struct Hostile {
    transfers: u64,
    waiting: VecDeque<Frame>,
}

impl Hostile {
    /// The frame that it offers.
    pub fn front(&mut self) -> Option<Frame> {
        while self.waiting.is_empty() {
            self.transfers += 1;
            let frames = transfer(self.transfers);
            let on_wire =
                |frame: &CanFrame| Frame::new(Id::Extended(frame.id()), Format::FD, frame.data()).ok();
            self.waiting.extend(frames.iter().filter_map(on_wire));
        }
        self.waiting.front().copied()
    }

    /// It is sent.
    pub fn sent(&mut self) {
        self.waiting.pop_front();
    }
}

/// The frames of transfer `number`, under the name of any node.
fn transfer(number: u64) -> Vec<CanFrame> {
    let draw = mix(number);
    let pick = |count: usize| (draw >> 32) as usize % count;
    let node = NodeId::new((draw >> 8 & 127) as u8).unwrap_or(NodeId::DEFAULT);
    let (port, payload) = match draw % 8 {
        0 => (GET_INFO_PORT, vec![]),
        1 => (LIST_PORT, (pick(80) as u16).to_le_bytes().to_vec()),
        2 | 3 => {
            // One bit, set.
            let name = TABLE[pick(TABLE.len())].name;
            (ACCESS_PORT, [&[name.len() as u8], name.as_bytes(), &[3, 1, 0, 1]].concat())
        }
        4 | 5 => {
            let command = COMMANDS[pick(COMMANDS.len())];
            let parameter = vec![draw as u8; if command == UNLOCK { SIGNATURE_BYTES } else { 4 }];
            (COMMAND_PORT, [&command.to_le_bytes()[..], &[parameter.len() as u8], &parameter].concat())
        }
        // Part of a file that was not asked for.
        6 => (FILE_READ_PORT, [vec![0, 0, 200, 0], vec![draw as u8; 200]].concat()),
        _ => {
            let port = [TIME_PORT, ALLOCATION_PORT][pick(2)];
            let message = MessageId { priority: Priority::Nominal, port, node };
            return Frames::new(message, number as u8, &draw.to_le_bytes()[..7]).collect();
        }
    };
    let role = if port == FILE_READ_PORT { ServiceRole::Response } else { ServiceRole::Request };
    let service =
        ServiceId { priority: Priority::Nominal, role, port, destination: NodeId::DEFAULT, source: node };
    Frames::new(service, number as u8, &payload).collect()
}
