//! From the command on the bus to the swapped firmware: node, file client, sink, bootloader.

use embassy_futures::block_on;

use slipsense::node::{
    Action, BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CHUNK_BYTES, COMMAND_PORT, FILE_READ_PORT,
    RECORD_PORT, Severity, UpdateTarget,
};
use slipsense::update::{Evidence, ImageVersion, Refusal, Run, Trial};
use slipsense::wire::TransferId;

use super::device::{Device, NEW, OLD, Sink, image, model, model_image};
use crate::node::commands::command;
use crate::node::files::{answer, offset};
use crate::node::{hear, node, request, said, text};

/// Serve `file` to a node that updates; the texts that it had for the bus.
fn update(sink: &mut Sink<'_>, begin: u16, file: &[u8]) -> Vec<String> {
    let mut node = node();
    hear(&mut node, request(COMMAND_PORT, 0, &command(begin, b"image.slip")), 0);
    let (mut texts, mut ended) = (Vec::new(), false);
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
        for (id, transfer, payload) in said(&mut node) {
            match id {
                TransferId::Message(id) if id.port == RECORD_PORT => texts.push(text(&payload)),
                TransferId::Service(id) if id.port == FILE_READ_PORT => {
                    let offset = offset(&payload);
                    let piece = &file[offset.min(file.len())..file.len().min(offset + CHUNK_BYTES)];
                    answer(&mut node, id, transfer, 0, piece, now);
                }
                _ => {}
            }
        }
        if ended && node.is_drained() {
            return texts;
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
