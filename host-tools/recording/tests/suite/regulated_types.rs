//! The regulated types as the crate `canadensis_data_types` 0.6 has them, which is generated from
//! OpenCyphal's own definitions: it encodes the requests that the node serves and decodes what the node
//! says.

use canadensis_data_types::uavcan::diagnostic::record_1_1::Record;
use canadensis_data_types::uavcan::file::read_1_1::{ReadRequest, ReadResponse};
use canadensis_data_types::uavcan::node::execute_command_1_3::{
    ExecuteCommandRequest, ExecuteCommandResponse,
};
use canadensis_data_types::uavcan::node::get_info_1_0::{GetInfoRequest, GetInfoResponse};
use canadensis_data_types::uavcan::node::heartbeat_1_0::{self, Heartbeat};
use canadensis_data_types::uavcan::node::id_1_0::ID;
use canadensis_data_types::uavcan::pnp::node_id_allocation_data_2_0::{self, NodeIDAllocationData};
use canadensis_data_types::uavcan::primitive::array::{
    bit_1_0, integer64_1_0, natural8_1_0, natural16_1_0, natural32_1_0,
};
use canadensis_data_types::uavcan::primitive::empty_1_0::Empty;
use canadensis_data_types::uavcan::primitive::unstructured_1_0::Unstructured;
use canadensis_data_types::uavcan::register::access_1_0::{self, AccessRequest, AccessResponse};
use canadensis_data_types::uavcan::register::list_1_0::{self, ListRequest, ListResponse};
use canadensis_data_types::uavcan::register::name_1_0::Name;
use canadensis_data_types::uavcan::register::value_1_0::Value;
use canadensis_data_types::uavcan::time::synchronization_1_0::{self, Synchronization};
use canadensis_data_types::uavcan::{diagnostic, file, node};
use canadensis_encoding::{Deserialize, Serialize};
use slipsense::node::{
    ACCESS_PORT, ALLOCATION_PORT, Action, BEGIN_SOFTWARE_UPDATE, COMMAND_PORT, FILE_READ_PORT, GET_INFO_PORT,
    HEARTBEAT_PORT, Identity, LIST_PORT, Node, RECORD_PORT, SELF_TEST, Severity, TIME_PORT, Version,
};
use slipsense::settings::{Damage, LoadReport, NODE_ID_UNSET, Origin, Setting, Settings};
use slipsense::wire::{Frames, MessageId, NodeId, Priority, ServiceId, ServiceRole, Sessions, TransferId};

const TOOL: NodeId = NodeId::new(9).unwrap();

fn identity() -> Identity {
    Identity {
        hardware_version: Version { major: 3, minor: 4 },
        software_version: Version { major: 5, minor: 6 },
        vcs_revision: 0x1122_3344_5566_7788,
        unique_id: std::array::from_fn(|i| 100 + i as u8),
        model_hash: Some(std::array::from_fn(|i| 200 + i as u8)),
        settings: LoadReport { origin: Origin::Stored, damage: Damage { settings: 5, ..Damage::default() } },
        entropy: None,
    }
}

fn bytes(message: &impl Serialize) -> Vec<u8> {
    let mut bytes = vec![0; message.size_bits().div_ceil(8)];
    message.serialize_to_bytes(&mut bytes);
    bytes
}

/// The payloads that the node has to say on this port, whole transfers.
fn said(node: &mut Node, wanted: u16) -> Vec<Vec<u8>> {
    let mut sessions = Sessions::<8, 640>::new();
    let mut said = Vec::new();
    while let Some(frame) = node.next_frame() {
        let id = TransferId::from_can(frame.id()).unwrap();
        let port = match id {
            TransferId::Message(id) => id.port,
            TransferId::Service(id) => id.port,
            TransferId::Anonymous(id) => {
                said.extend((id.port == wanted).then(|| frame.data()[..frame.data().len() - 1].to_vec()));
                continue;
            }
        };
        let arrived = sessions.accept(id, &frame, 0).unwrap();
        said.extend(arrived.filter(|_| port == wanted).map(|whole| whole.payload.to_vec()));
    }
    said
}

fn send(node: &mut Node, role: ServiceRole, port: u16, transfer: u8, message: &impl Serialize) {
    let id =
        ServiceId { priority: Priority::Nominal, role, port, destination: NodeId::DEFAULT, source: TOOL };
    for frame in Frames::new(id, transfer, &bytes(message)) {
        node.accept(&frame, 0);
    }
}

fn call<R: Deserialize>(node: &mut Node, port: u16, transfer: u8, request: &impl Serialize) -> R {
    send(node, ServiceRole::Request, port, transfer, request);
    let [answer] = &said(node, port)[..] else { panic!("one answer on port {port}") };
    R::deserialize_from_bytes(answer).unwrap()
}

fn access(node: &mut Node, transfer: u8, name: &str, value: Value) -> AccessResponse {
    let name = Name { name: name.bytes().collect() };
    call(node, ACCESS_PORT, transfer, &AccessRequest { name, value })
}

#[test]
fn ports_and_commands_are_the_standards() {
    for (theirs, ours) in [
        (node::get_info_1_0::SERVICE.into(), GET_INFO_PORT),
        (node::execute_command_1_3::SERVICE.into(), COMMAND_PORT),
        (access_1_0::SERVICE.into(), ACCESS_PORT),
        (list_1_0::SERVICE.into(), LIST_PORT),
        (file::read_1_1::SERVICE.into(), FILE_READ_PORT),
        (heartbeat_1_0::SUBJECT.into(), HEARTBEAT_PORT),
        (synchronization_1_0::SUBJECT.into(), TIME_PORT),
        (node_id_allocation_data_2_0::SUBJECT.into(), ALLOCATION_PORT),
        (diagnostic::record_1_1::SUBJECT.into(), RECORD_PORT),
        (ExecuteCommandRequest::COMMAND_BEGIN_SOFTWARE_UPDATE, BEGIN_SOFTWARE_UPDATE),
        (ExecuteCommandRequest::COMMAND_RESTART, slipsense::node::RESTART),
        (ExecuteCommandRequest::COMMAND_FACTORY_RESET, slipsense::node::FACTORY_RESET),
        (ExecuteCommandRequest::COMMAND_STORE_PERSISTENT_STATES, slipsense::node::STORE),
        (ExecuteCommandRequest::COMMAND_IDENTIFY, slipsense::node::IDENTIFY),
    ] {
        assert_eq!(theirs, ours);
    }
}

#[test]
fn what_the_node_says_of_itself_decodes() {
    let mut node = Node::new(identity(), Settings::new());
    let info: GetInfoResponse = call(&mut node, GET_INFO_PORT, 0, &GetInfoRequest {});
    let versions = [info.protocol_version, info.hardware_version, info.software_version];
    assert_eq!(versions.map(|version| (version.major, version.minor)), [(1, 0), (3, 4), (5, 6)]);
    assert_eq!(info.software_vcs_revision_id, 0x1122_3344_5566_7788);
    assert_eq!(info.unique_id, identity().unique_id);
    assert_eq!(info.name, b"slipsense.fingertip");
    assert_eq!(info.software_image_crc, [0xC8C9_CACB_CCCD_CECF]);
    assert!(info.certificate_of_authenticity.is_empty());

    node.poll(70_500_000);
    let beat = Heartbeat::deserialize_from_bytes(&said(&mut node, HEARTBEAT_PORT)[0]).unwrap();
    // Settings are damaged: caution, and its bit.
    assert_eq!((beat.uptime, beat.health.value, beat.mode.value), (70, 2, 1));
    assert_eq!(beat.vendor_specific_status_code, 64);

    node.report(Severity::Warning, format_args!("something {}", 7));
    let record = Record::deserialize_from_bytes(&said(&mut node, RECORD_PORT)[0]).unwrap();
    assert_eq!((record.severity.value, &record.text[..]), (4, &b"something 7"[..]));
    assert_eq!(record.timestamp.microsecond, 0);
}

#[test]
fn values_of_every_kind_decode() {
    let mut node = Node::new(identity(), Settings::new());
    let list: ListResponse = call(&mut node, LIST_PORT, 0, &ListRequest { index: 2 });
    assert_eq!(list.name.name, b"slipsense.sensors");
    let value = Value::Natural8(natural8_1_0::Natural8 { value: [3].into_iter().collect() });
    let answer = access(&mut node, 0, "slipsense.sensors", value);
    assert!(answer.mutable && answer.persistent);
    let Value::Natural8(array) = answer.value else { panic!("{:?}", node.settings()) };
    assert_eq!(array.value, [3]);
    assert_eq!(node.settings().sensors(), 3);

    let value = Value::Natural16(natural16_1_0::Natural16 { value: [65_535].into_iter().collect() });
    let Value::Natural16(array) = access(&mut node, 1, "uavcan.node.id", value).value else { panic!() };
    assert_eq!(array.value, [65_535]);
    let mask: Vec<u32> = (0..32).map(|row| row * 0x0102_0304).collect();
    let value = Value::Natural32(natural32_1_0::Natural32 { value: mask.iter().copied().collect() });
    let Value::Natural32(array) = access(&mut node, 2, "slipsense.sensor.2.mask", value).value else {
        panic!()
    };
    assert_eq!(array.value[..], mask[..]);
    assert_eq!(node.settings().taxel_mask(2).0.to_vec(), mask);

    let mut bits = canadensis_encoding::bits::BitArray::<256>::new(1);
    bits.set(0, false);
    let value = Value::Bit(bit_1_0::Bit { value: bits });
    let Value::Bit(array) = access(&mut node, 3, "slipsense.pnp", value).value else { panic!() };
    assert_eq!((array.value.len(), array.value.get(0)), (1, false));
    assert!(!node.settings().is_on(Setting::PlugAndPlay));

    let empty = || Value::Empty(Empty {});
    let Value::Unstructured(hash) = access(&mut node, 4, "slipsense.model.hash", empty()).value else {
        panic!()
    };
    assert_eq!(hash.value[..], identity().model_hash.unwrap());
    let answer = access(&mut node, 5, "slipsense.time.offset_us", empty());
    let Value::Integer64(integer64_1_0::Integer64 { value }) = answer.value else { panic!() };
    assert_eq!((value[..].to_vec(), answer.mutable, answer.persistent), (vec![0], false, false));
    assert!(matches!(access(&mut node, 6, "none", empty()).value, Value::Empty(_)));
}

#[test]
fn commands_files_time_and_addresses_decode() {
    let mut node = Node::new(identity(), Settings::new());
    let parameter = b"some/file.bin".iter().copied().collect();
    let request = ExecuteCommandRequest { command: BEGIN_SOFTWARE_UPDATE, parameter };
    let answer: ExecuteCommandResponse = call(&mut node, COMMAND_PORT, 0, &request);
    assert_eq!((answer.status, answer.output.len()), (0, 0));
    let Some(Action::BeginUpdate { target, file }) = node.take_action() else { panic!() };
    node.begin_download(target, file, 1_000);
    node.poll(0);
    let requests = said(&mut node, FILE_READ_PORT);
    let request = ReadRequest::deserialize_from_bytes(&requests[0]).unwrap();
    assert_eq!((request.offset, &request.path.path[..]), (0, &b"some/file.bin"[..]));
    let data = Unstructured { value: (0..=255).collect() };
    let error = file::error_1_0::Error { value: 0 };
    send(&mut node, ServiceRole::Response, FILE_READ_PORT, 0, &ReadResponse { error, data });
    let chunk = node.take_chunk().unwrap();
    assert_eq!((chunk.offset, chunk.last, chunk.bytes[..].to_vec()), (0, false, (0..=255).collect()));
    node.chunk_done(&chunk, Ok(()));
    node.poll(0);
    let request = ReadRequest::deserialize_from_bytes(&said(&mut node, FILE_READ_PORT)[0]).unwrap();
    assert_eq!(request.offset, 256);

    let request = ExecuteCommandRequest { command: SELF_TEST, parameter: Default::default() };
    send(&mut node, ServiceRole::Request, COMMAND_PORT, 1, &request);
    node.command_done(Err("a reason that is longer than the forty-six bytes that there are"));
    let answer = ExecuteCommandResponse::deserialize_from_bytes(&said(&mut node, COMMAND_PORT)[0]).unwrap();
    assert_eq!(
        (answer.status, &answer.output[..]),
        (1, &b"a reason that is longer than the forty-six byt"[..])
    );

    let message = MessageId { priority: Priority::Nominal, port: TIME_PORT, node: TOOL };
    for (transfer, (at, stamp)) in
        [(1_000u64, 0u64), (500_000, 0x0012_3456_789A_BCDE)].into_iter().enumerate()
    {
        let sync = Synchronization { previous_transmission_timestamp_microsecond: stamp };
        for frame in Frames::new(message, transfer as u8, &bytes(&sync)) {
            node.accept(&frame, at);
        }
    }
    assert_eq!(node.bus_time_us(1_000), Some(0x0012_3456_789A_BCDE));

    let mut settings = Settings::new();
    settings.set(Setting::NodeId, &[NODE_ID_UNSET]).unwrap();
    let mut node = Node::new(identity(), settings);
    let next = node.poll(0);
    node.poll(next);
    let request = NodeIDAllocationData::deserialize_from_bytes(&said(&mut node, ALLOCATION_PORT)[0]).unwrap();
    assert_eq!((request.node_id.value, request.unique_id), (125, identity().unique_id));
    let answer = NodeIDAllocationData { node_id: ID { value: 77 }, unique_id: identity().unique_id };
    let message = MessageId { port: ALLOCATION_PORT, ..message };
    for frame in Frames::new(message, 0, &bytes(&answer)) {
        node.accept(&frame, next);
    }
    assert_eq!(node.node_id(), NodeId::new(77));
}
