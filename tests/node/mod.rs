//! The node: what it answers, what it asks the board for, what it withstands. The layouts of the regulated
//! types are compared with pycyphal by `cargo xtask test --only node` and with canadensis in
//! `slipsense-recording`.

pub mod commands;
pub mod files;
mod lock;
mod mutated;
mod network;
mod page;
pub mod registers;

use slipsense::node::{Identity, Node, RECORD_PORT, Version};
use slipsense::settings::{Damage, LoadReport, Origin, Settings};
use slipsense::wire::{
    CanFrame, Frames, MessageId, NodeId, Priority, ServiceId, ServiceRole, Sessions, TransferId,
};

pub const NODE: NodeId = NodeId::DEFAULT;
pub const TOOL: NodeId = NodeId::new(120).unwrap();

pub fn identity() -> Identity {
    Identity {
        hardware_version: Version { major: 1, minor: 2 },
        software_version: Version::SOFTWARE,
        vcs_revision: 0x0123_4567_89AB_CDEF,
        unique_id: *b"0123456789abcdef",
        model_hash: Some(std::array::from_fn(|i| i as u8)),
        settings: LoadReport { origin: Origin::Stored, damage: Damage::default() },
        entropy: None,
    }
}

pub fn node() -> Node {
    let mut node = Node::new(identity(), Settings::new());
    node.set_operational();
    node
}

pub fn request(port: u16, transfer: u8, payload: &[u8]) -> Vec<CanFrame> {
    let (priority, role) = (Priority::Nominal, ServiceRole::Request);
    Frames::new(ServiceId { priority, role, port, destination: NODE, source: TOOL }, transfer, payload)
        .collect()
}

fn message(source: NodeId, port: u16, transfer: u8, payload: &[u8]) -> Vec<CanFrame> {
    Frames::new(MessageId { priority: Priority::Nominal, port, node: source }, transfer, payload).collect()
}

/// The node receives these frames.
pub fn hear(node: &mut Node, frames: impl IntoIterator<Item = CanFrame>, now_us: u64) {
    frames.into_iter().for_each(|frame| node.accept(&frame, now_us));
}

/// Everything that the node has to say: identifiers, transfer identifiers and payloads.
fn said(node: &mut Node) -> Vec<(TransferId, u8, Vec<u8>)> {
    let mut sessions = Box::new(Sessions::<16, 640>::new());
    let mut said = Vec::new();
    while let Some(frame) = node.next_frame() {
        let id = TransferId::from_can(frame.id()).unwrap();
        if let TransferId::Anonymous(_) = id {
            let (tail, payload) = frame.data().split_last().unwrap();
            assert_eq!(tail & 0xE0, 0xE0, "an anonymous message has one frame");
            said.push((id, tail & 31, payload.to_vec()));
        } else if let Some(arrived) = sessions.accept(id, &frame, 0).unwrap() {
            said.push((id, arrived.transfer, arrived.payload.to_vec()));
        }
    }
    said
}

/// The node's answer to a request; records and heartbeats are passed over.
fn ask(node: &mut Node, port: u16, transfer: u8, payload: &[u8], now_us: u64) -> Option<Vec<u8>> {
    hear(node, request(port, transfer, payload), now_us);
    let mut answers = said(node).into_iter().filter_map(|(id, number, payload)| match id {
        TransferId::Service(id) if id.role == ServiceRole::Response => {
            assert_eq!((id.port, id.source, id.destination, number), (port, NODE, TOOL, transfer));
            assert_eq!(id.priority, Priority::Nominal);
            Some(payload)
        }
        _ => None,
    });
    let answer = answers.next();
    assert_eq!(answers.next(), None);
    answer
}

/// The text of a diagnostic record.
pub fn text(record: &[u8]) -> String {
    String::from_utf8(record[9..9 + usize::from(record[8])].to_vec()).unwrap()
}

/// The texts of the diagnostic records that the node has to say.
pub fn records(node: &mut Node) -> Vec<String> {
    let is_record = |id: &TransferId| matches!(id, TransferId::Message(id) if id.port == RECORD_PORT);
    said(node).iter().filter(|(id, ..)| is_record(id)).map(|(.., bytes)| text(bytes)).collect()
}
