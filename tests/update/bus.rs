//! From the command on the bus to the swapped firmware: node, file client, sink, bootloader.

use embassy_futures::block_on;

use slipsense::node::{
    Action, BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, COMMAND_PORT, Severity, UpdateTarget,
};
use slipsense::update::{Evidence, Refusal, Run, Trial};

use super::device::{Device, NEW, OLD, Sink, header, image, model, model_image, sign};
use crate::node::commands::command;
use crate::node::files::serve;
use crate::node::{hear, node, records, request};

/// Serve `file` to a node that updates; the texts that it has for the bus at the end.
fn update(sink: &mut Sink<'_>, begin: u16, file: &[u8]) -> Vec<String> {
    let mut node = node();
    hear(&mut node, request(COMMAND_PORT, 0, &command(begin, b"firmware.bin")), 0);
    let Some(Action::BeginUpdate { target, file: place }) = node.take_action() else { panic!("no update") };
    match block_on(sink.begin(target)) {
        Ok(room) => {
            node.begin_download(target, place, room);
            serve(&mut node, file, sink, usize::MAX);
        }
        Err(why) => node.report(Severity::Error, format_args!("{} not taken: {why}", target.name())),
    }
    records(&mut node)
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
    let mut forged = image(NEW);
    forged[70] ^= 1;
    // The others give no other path to the bus: `refusals`.
    for (file, why) in [(&forged[..], Refusal::WrongSignature), (&image(NEW)[..1000], Refusal::Truncated)] {
        let said = device.sink(OLD, |sink| update(sink, BEGIN_SOFTWARE_UPDATE, file));
        assert!(said.contains(&format!("firmware not taken: {why}")), "{said:?}");
        assert_eq!((device.run(), device.boots()), (Run::Confirmed, OLD));
    }
    let mut corrupt = model(1);
    corrupt[200] ^= 1;
    let corrupt = sign(&header(UpdateTarget::Model, NEW, &corrupt), &corrupt);
    let said = device.sink(OLD, |sink| update(sink, BEGIN_MODEL_UPDATE, &corrupt));
    let refusal = "model not taken: corrupt model: its SHA-256 does not match";
    assert!(said.iter().any(|text| text == refusal), "{said:?}");
    let said = device.sink(OLD, |sink| update(sink, BEGIN_MODEL_UPDATE, &model_image(NEW, 3)));
    assert!(said.iter().any(|text| text.starts_with("model received and accepted")), "{said:?}");
    assert_eq!(device.model(), Ok((NEW, model(3))));

    let device = Device::on_trial();
    let said = device.sink(NEW, |sink| update(sink, BEGIN_SOFTWARE_UPDATE, &image(NEW)));
    assert!(said.contains(&format!("firmware not taken: {}", Refusal::OnTrial)), "{said:?}");
}
