//! The node: what it answers, what it asks the board for, what it withstands. The layouts of the regulated
//! types are compared with pycyphal by `cargo xtask test --only node` and with canadensis in
//! `slipsense-recording`.

mod commands;
mod files;
mod lock;
mod mutated;
mod network;
mod page;
mod registers;

use slipsense::node::{Identity, Node, Version};
use slipsense::settings::{Damage, LoadReport, Origin, Settings};
use slipsense::wire::{
    CanFrame, Frames, MessageId, NodeId, Priority, ServiceId, ServiceRole, Sessions, TransferId,
};

const NODE: NodeId = NodeId::DEFAULT;
const TOOL: NodeId = NodeId::new(120).unwrap();

fn identity() -> Identity {
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

fn node() -> Node {
    let mut node = Node::new(identity(), Settings::new());
    node.set_operational();
    node
}

fn request(port: u16, transfer: u8, payload: &[u8]) -> Vec<CanFrame> {
    let (priority, role) = (Priority::Nominal, ServiceRole::Request);
    Frames::new(ServiceId { priority, role, port, destination: NODE, source: TOOL }, transfer, payload)
        .collect()
}

fn message(source: NodeId, port: u16, transfer: u8, payload: &[u8]) -> Vec<CanFrame> {
    Frames::new(MessageId { priority: Priority::Nominal, port, node: source }, transfer, payload).collect()
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
    for frame in request(port, transfer, payload) {
        node.accept(&frame, now_us);
    }
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

/// The texts of the diagnostic records that the node has to say.
fn records(node: &mut Node) -> Vec<String> {
    let port_of = |id| match id {
        TransferId::Message(id) => id.port,
        _ => 0,
    };
    let records = said(node).into_iter().filter(|(id, _, _)| port_of(*id) == slipsense::node::RECORD_PORT);
    records
        .map(|(_, _, bytes)| String::from_utf8(bytes[9..9 + usize::from(bytes[8])].to_vec()).unwrap())
        .collect()
}
