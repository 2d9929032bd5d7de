//! A file pulled from another node, on a bus that loses frames and from servers that misbehave.

use embassy_futures::block_on;
use slipsense::node::{
    ANSWER_TIMEOUT_US, Action, BEGIN_MODEL_UPDATE, BEGIN_SOFTWARE_UPDATE, CHUNK_BYTES, COMMAND_PORT,
    FILE_READ_PORT, FileSink, Mode, Node, PATH_MAX, SIGNATURE_PAUSE_US, TRIES, UpdateTarget,
};
use slipsense::wire::{Frames, NodeId, Priority, ServiceId, ServiceRole, TransferId};

use super::commands::command;
use super::{NODE, TOOL, ask, hear, node, records, said};

#[derive(Default)]
struct Memory {
    bytes: Vec<u8>,
    writes: usize,
    finished: Option<u32>,
    refuse_at: Option<u32>,
}

impl FileSink for Memory {
    async fn write(&mut self, _: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), &'static str> {
        if self.refuse_at == Some(offset) {
            return Err("the flash refused a write");
        }
        assert_eq!(offset as usize, self.bytes.len());
        self.bytes.extend(bytes);
        self.writes += 1;
        Ok(())
    }

    async fn finish(&mut self, _: UpdateTarget, length: u32) -> Result<(), &'static str> {
        self.finished = Some(length);
        if self.bytes.starts_with(b"bad") { Err("wrong signature") } else { Ok(()) }
    }
}

/// The requests to read that the node sends: identifier, transfer, offset, path.
fn requests(node: &mut Node) -> Vec<(ServiceId, u8, usize, Vec<u8>)> {
    let request = |(id, transfer, payload): (_, _, Vec<u8>)| match id {
        TransferId::Service(id) if id.port == FILE_READ_PORT => {
            assert_eq!((id.role, id.destination, id.source), (ServiceRole::Request, TOOL, NODE));
            let offset = payload[..5].iter().rev().fold(0, |offset, &byte| offset << 8 | usize::from(byte));
            Some((id, transfer, offset, payload[6..6 + usize::from(payload[5])].to_vec()))
        }
        _ => None,
    };
    said(node).into_iter().filter_map(request).collect()
}

fn answer(node: &mut Node, id: ServiceId, transfer: u8, error: u16, bytes: &[u8], now: u64) {
    let payload = [&error.to_le_bytes()[..], &(bytes.len() as u16).to_le_bytes(), bytes].concat();
    hear(node, Frames::new(id.response(), transfer, &payload), now);
}

fn begin(node: &mut Node, call: u8, number: u16, path: &[u8], length_max: u32) {
    assert_eq!(ask(node, COMMAND_PORT, call, &command(number, path), 0).unwrap()[0], 0);
    let Some(Action::BeginUpdate { target, file }) = node.take_action() else { panic!("no update") };
    assert_eq!((file.server, &file.path[..]), (TOOL, path));
    node.begin_download(target, file, length_max);
}

/// Serve `file` until the node asks no more; every `lose`-th request is lost. Actions that came of it.
pub fn serve(node: &mut Node, file: &[u8], sink: &mut impl FileSink, lose: usize) -> Vec<Action> {
    let (mut now, mut count, mut actions) = (1_000, 0, Vec::new());
    for _ in 0..10_000 {
        node.poll(now);
        for (id, transfer, offset, path) in requests(node) {
            count += 1;
            assert_eq!(path, b"firmware.bin");
            if count % lose != 0 {
                let end = file.len().min(offset + CHUNK_BYTES);
                answer(node, id, transfer, 0, &file[offset..end], now);
            }
        }
        if let Some(chunk) = node.take_chunk() {
            let result = block_on(chunk.deliver(sink));
            node.chunk_done(&chunk, result);
        }
        actions.extend(node.take_action());
        now += ANSWER_TIMEOUT_US / 3;
        if node.mode() != Mode::SoftwareUpdate {
            break;
        }
    }
    actions
}

#[test]
fn a_file_arrives_whole_also_when_requests_are_lost() {
    for length in [0, 1, 255, 256, 257, 512, 100_000] {
        for lose in [usize::MAX, 3] {
            let file: Vec<u8> = (0..length).map(|i: usize| (i * 7 + i / 256) as u8).collect();
            let (mut node, mut sink) = (node(), Memory::default());
            begin(&mut node, 0, BEGIN_SOFTWARE_UPDATE, b"firmware.bin", 100_000);
            assert_eq!(node.mode(), Mode::SoftwareUpdate);
            let actions = serve(&mut node, &file, &mut sink, lose);
            let target = UpdateTarget::Firmware;
            assert_eq!(actions, [Action::UpdateReceived { target, length: length as u32 }]);
            assert_eq!((sink.finished, sink.bytes == file), (Some(length as u32), true));
            assert_eq!(
                sink.writes,
                length.div_ceil(CHUNK_BYTES).max(1),
                "an empty piece only of an empty file"
            );
            assert_eq!(node.mode(), Mode::Operational);
        }
    }
}

#[test]
fn the_longest_path_is_asked_for() {
    let mut node = node();
    begin(&mut node, 0, BEGIN_SOFTWARE_UPDATE, &[b'p'; PATH_MAX], 1_000);
    node.poll(1_000);
    assert_eq!(requests(&mut node)[0].3, [b'p'; PATH_MAX]);
}

#[test]
fn a_refusal_is_reported_with_its_reason() {
    let failed = [Action::UpdateFailed { target: UpdateTarget::Model }];
    let refused = |file: &[u8], refuse_at, length_max| {
        let (mut node, mut sink) = (node(), Memory { refuse_at, ..Memory::default() });
        begin(&mut node, 1, BEGIN_MODEL_UPDATE, b"firmware.bin", length_max);
        assert_eq!(serve(&mut node, file, &mut sink, usize::MAX), failed);
        records(&mut node)
    };
    assert_eq!(refused(b"bad image", None, 1_000), ["model not taken: wrong signature"]);
    assert_eq!(refused(&[1; 600], Some(512), 1_000), ["model not taken: the flash refused a write"]);
    assert_eq!(refused(&[1; 600], None, 599), ["model not taken: longer than 599 bytes"]);
}

#[test]
fn a_server_that_refuses_or_falls_silent_ends_it() {
    let mut node = node();
    begin(&mut node, 2, BEGIN_SOFTWARE_UPDATE, b"x", 10);
    node.poll(0);
    let (id, transfer, ..) = requests(&mut node)[0];
    // Not the one that was asked: another node, another request.
    answer(&mut node, ServiceId { destination: NodeId::new(7).unwrap(), ..id }, transfer, 2, &[], 0);
    answer(&mut node, id, transfer.wrapping_add(1), 2, &[], 0);
    assert_eq!(node.mode(), Mode::SoftwareUpdate);
    answer(&mut node, id, transfer, 2, &[], 0);
    assert_eq!(records(&mut node), ["firmware not taken: the server has no such file"]);
    assert_eq!(node.take_action(), Some(Action::UpdateFailed { target: UpdateTarget::Firmware }));

    node.poll(SIGNATURE_PAUSE_US);
    begin(&mut node, 3, BEGIN_SOFTWARE_UPDATE, b"x", 10);
    let mut asked = 0;
    for tenth in 0..100 {
        node.poll(3_000_000 + tenth * ANSWER_TIMEOUT_US / 10);
        if node.mode() != Mode::SoftwareUpdate {
            assert_eq!(tenth, 10 * u64::from(TRIES));
            let record = format!("firmware not taken: the server did not answer {TRIES} requests");
            assert!(records(&mut node).contains(&record));
            break;
        }
        asked += requests(&mut node).len();
    }
    assert_eq!(asked, usize::from(TRIES));
}

#[test]
fn an_answer_that_is_cut_short_ends_it() {
    let mut node = node();
    begin(&mut node, 0, BEGIN_SOFTWARE_UPDATE, b"x", 1_000);
    node.poll(0);
    let (id, transfer, ..) = requests(&mut node)[0];
    hear(&mut node, Frames::new(id.response(), transfer, &[0, 0, 100, 0, 1, 2, 3]), 0);
    assert_eq!(records(&mut node), ["firmware not taken: the server's answer is cut short"]);
}

#[test]
fn a_new_file_replaces_the_old_one_and_its_late_pieces() {
    let (mut node, mut sink) = (node(), Memory::default());
    begin(&mut node, 4, BEGIN_SOFTWARE_UPDATE, b"old", 1_000);
    node.poll(0);
    let (id, transfer, ..) = requests(&mut node)[0];
    answer(&mut node, id, transfer, 0, &[1; 256], 0);
    let late = node.take_chunk().unwrap();
    begin(&mut node, 5, BEGIN_SOFTWARE_UPDATE, b"firmware.bin", 1_000);
    node.chunk_done(&late, Err("too late"));
    assert_eq!(node.mode(), Mode::SoftwareUpdate);
    let actions = serve(&mut node, &[2; 300], &mut sink, usize::MAX);
    assert_eq!(actions, [Action::UpdateReceived { target: UpdateTarget::Firmware, length: 300 }]);
    assert_eq!(sink.bytes, [2; 300]);
    assert_eq!(Priority::Low, id.priority);
    // Nobody may have flash erased as often as he likes by never finishing.
    let third = ask(&mut node, COMMAND_PORT, 6, &command(BEGIN_SOFTWARE_UPDATE, b"x"), 0).unwrap();
    assert_eq!((third[0], node.take_action()), (5, None));
}

/// The board may install it meanwhile: "not taken" would be wrong.
#[test]
fn no_file_replaces_one_that_is_being_checked() {
    let mut node = node();
    begin(&mut node, 4, BEGIN_SOFTWARE_UPDATE, b"firmware.bin", 1_000);
    node.poll(0);
    let (id, transfer, ..) = requests(&mut node)[0];
    answer(&mut node, id, transfer, 0, &[1; 100], 0);
    let whole = node.take_chunk().unwrap();
    let again = ask(&mut node, COMMAND_PORT, 5, &command(BEGIN_SOFTWARE_UPDATE, b"firmware.bin"), 0).unwrap();
    assert_eq!((again[0], node.take_action()), (5, None));
    node.chunk_done(&whole, Ok(()));
    let received = Action::UpdateReceived { target: UpdateTarget::Firmware, length: 100 };
    assert_eq!(node.take_action(), Some(received));
}

#[test]
fn after_a_refused_image_no_other_begins_for_a_while() {
    let (mut node, mut sink) = (node(), Memory::default());
    begin(&mut node, 0, BEGIN_SOFTWARE_UPDATE, b"firmware.bin", 100_000);
    let target = UpdateTarget::Firmware;
    assert_eq!(serve(&mut node, b"bad", &mut sink, usize::MAX), [Action::UpdateFailed { target }]);
    let again = command(BEGIN_MODEL_UPDATE, b"model.slip");
    let refused_at = 1_000;
    let status = |node: &mut Node, call, now| ask(node, COMMAND_PORT, call, &again, now).unwrap()[0];
    assert_eq!(status(&mut node, 1, refused_at + SIGNATURE_PAUSE_US - 1), 5);
    assert_eq!(node.take_action(), None);
    // The first pieces came within a second of the start.
    assert_eq!(status(&mut node, 2, refused_at + 2 * SIGNATURE_PAUSE_US), 0);
}
