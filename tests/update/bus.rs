//! From the command on the bus to the swapped firmware: node, file client, sink, bootloader.

use embassy_futures::block_on;
use slipsense::node::{
    Action, BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CHUNK_BYTES, COMMAND_PORT, FILE_READ_PORT, Identity,
    Node, RECORD_PORT, Severity, UpdateTarget, Version,
};
use slipsense::settings::{Damage, LoadReport, Origin, Settings};
use slipsense::update::{Evidence, ImageVersion, Refusal, Run, Trial};
use slipsense::wire::{Frames, NodeId, Priority, ServiceId, ServiceRole, Sessions, TransferId};

use super::device::{Device, NEW, OLD, Sink, image, model, model_image};

const TOOL: NodeId = NodeId::new(120).unwrap();

fn node() -> Node {
    let settings = LoadReport { origin: Origin::Stored, damage: Damage::default() };
    let mut node = Node::new(
        Identity {
            hardware_version: Version { major: 1, minor: 0 },
            software_version: Version::SOFTWARE,
            vcs_revision: 0,
            unique_id: *b"0123456789abcdef",
            model_hash: None,
            settings,
            entropy: None,
        },
        Settings::new(),
    );
    node.set_operational();
    node
}

/// Serve `file` to a node that updates; the texts that it had for the bus.
fn update(sink: &mut Sink<'_>, command: u16, file: &[u8]) -> Vec<String> {
    let mut node = node();
    let service = |role, port, destination, source| {
        let priority = Priority::Nominal;
        ServiceId { priority, role, port, destination, source }
    };
    let path = b"image.slip";
    let request = [&command.to_le_bytes()[..], &[path.len() as u8], path].concat();
    let id = service(ServiceRole::Request, COMMAND_PORT, NodeId::DEFAULT, TOOL);
    for frame in Frames::new(id, 0, &request) {
        node.accept(&frame, 0);
    }
    let (mut said, mut ended) = (Vec::new(), false);
    let mut sessions = Box::new(Sessions::<16, 640>::new());
    for now in (1_000..).step_by(1_000).take(20_000) {
        node.poll(now);
        while let Some(action) = node.take_action() {
            match action {
                Action::BeginUpdate { target, file } => match block_on(sink.begin(target)) {
                    Ok(room) => node.begin_download(target, file, room),
                    Err(why) => {
                        node.report(Severity::Error, format_args!("{} not taken: {why}", target.name()));
                        ended = true;
                    }
                },
                Action::UpdateReceived { .. } | Action::UpdateFailed { .. } => ended = true,
                other => panic!("{other:?}"),
            }
        }
        if let Some(chunk) = node.take_chunk() {
            let result = block_on(chunk.deliver(sink));
            node.chunk_done(&chunk, result);
        }
        while let Some(frame) = node.next_frame() {
            let id = TransferId::from_can(frame.id()).unwrap();
            let Some(arrived) = sessions.accept(id, &frame, now).unwrap() else { continue };
            match id {
                TransferId::Message(id) if id.port == RECORD_PORT => {
                    let text = &arrived.payload[9..9 + usize::from(arrived.payload[8])];
                    said.push(String::from_utf8(text.to_vec()).unwrap());
                }
                TransferId::Service(id) if id.port == FILE_READ_PORT => {
                    let offset =
                        arrived.payload[..5].iter().rev().fold(0, |sum, &byte| sum << 8 | usize::from(byte));
                    let piece = &file[offset.min(file.len())..file.len().min(offset + CHUNK_BYTES)];
                    let answer = [&[0, 0], &(piece.len() as u16).to_le_bytes()[..], piece].concat();
                    let back = service(ServiceRole::Response, FILE_READ_PORT, id.source, id.destination);
                    for frame in Frames::new(back, arrived.transfer, &answer) {
                        node.accept(&frame, now);
                    }
                }
                _ => {}
            }
        }
        if ended && node.is_drained() {
            return said;
        }
    }
    panic!("the update does not end");
}

#[test]
fn a_firmware_comes_over_the_bus_runs_and_confirms() {
    let device = Device::new();
    let file = image(NEW);
    let said = device.sink(OLD, |sink| update(sink, BEGIN_SOFTWARE_UPDATE, &file));
    let text = format!("firmware received and accepted, {} bytes", file.len());
    assert!(said.contains(&text), "{said:?}");
    assert_eq!(device.boots(), NEW);
    let mut trial = Trial::new(device.run());
    let evidence = |frames| Evidence { frames, heartbeats: frames / 240, requests: 1, senses: true };
    let confirmed = (0u32..20_000).find(|&frames| trial.observe(evidence(frames))).unwrap();
    assert_eq!(confirmed, 2_400);
    device.confirm();
    assert_eq!((device.boots(), device.run()), (NEW, Run::Confirmed));
}

#[test]
fn refusals_are_told_on_the_bus() {
    let device = Device::new();
    let mut unsigned = image(NEW);
    unsigned[64..128].fill(0);
    let mut forged = image(NEW);
    forged[70] ^= 1;
    let older = image(ImageVersion { patch: 0, ..OLD });
    let mut wrong_board = super::device::header(UpdateTarget::Firmware, NEW, &[1; 600]);
    wrong_board.board = 1;
    let wrong_board = super::device::sign(&wrong_board, &[1; 600]);
    for (file, why) in [
        (&unsigned[..], Refusal::Unsigned),
        (&forged, Refusal::WrongSignature),
        (&image(NEW)[..1000], Refusal::Truncated),
        (&older, Refusal::Older),
        (&wrong_board, Refusal::WrongBoard),
    ] {
        let said = device.sink(OLD, |sink| update(sink, BEGIN_SOFTWARE_UPDATE, file));
        assert!(said.contains(&format!("firmware not taken: {why}")), "{said:?}");
        assert_eq!((device.run(), device.boots()), (Run::Confirmed, OLD));
    }
    let mut corrupt = model(1);
    corrupt[200] ^= 1;
    let corrupt = super::device::sign(&super::device::header(UpdateTarget::Model, NEW, &corrupt), &corrupt);
    let said = device.sink(OLD, |sink| update(sink, BEGIN_MODEL_UPDATE, &corrupt));
    assert!(
        said.contains(&"model not taken: corrupt model: its SHA-256 does not match".to_owned()),
        "{said:?}"
    );
    let said = device.sink(OLD, |sink| update(sink, BEGIN_MODEL_UPDATE, &model_image(NEW, 3)));
    assert!(said.iter().any(|text| text.starts_with("model received and accepted")), "{said:?}");
    assert_eq!(device.model(), Ok((NEW, model(3))));

    assert_eq!(device.install(OLD, UpdateTarget::Firmware, &image(NEW)), Ok(()));
    assert_eq!(device.boots(), NEW);
    let said = device.sink(NEW, |sink| update(sink, BEGIN_SOFTWARE_UPDATE, &image(NEW)));
    assert!(said.contains(&format!("firmware not taken: {}", Refusal::OnTrial)), "{said:?}");
}
