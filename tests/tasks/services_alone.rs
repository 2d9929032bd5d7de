//! The services task when nobody hears it, and a new firmware that has to show that somebody does.

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use slipsense::health::{self, SensorHealth, Status};
use slipsense::node::{GET_INFO_PORT, HEARTBEAT_PORT, RECORD_PORT};
use slipsense::tasks::Shared;
use slipsense::update::{self, CONFIRM_FRAMES, ImageVersion, Notice, Refusal, SlotModel};

use super::services::{Bus, Run, Said, decided, with_status};
use crate::nameless;

#[test]
fn off_the_bus_nothing_piles_up() {
    let requests: Vec<_> = (0..300).map(|n| (1_000 + 10 * n, GET_INFO_PORT, Vec::new())).collect();
    let off = |ms: u64, _: &Shared<NoopRawMutex>, bus: &Bus| bus.off.set((500..4_500).contains(&ms));
    let ran = Run { meanwhile: &off, ..Run::new(&requests, 6_000) }.run();
    // Back on the bus: what the bounded queues held, then heartbeats as ever.
    let later = |said: &&&Said| said.0 > 4_510;
    assert!(ran.answers(GET_INFO_PORT).iter().filter(later).count() == 0);
    assert!((1..=2).contains(&ran.messages(HEARTBEAT_PORT).iter().filter(later).count()));
    assert!(ran.unfed_us <= 25_000);
}

#[test]
fn a_node_without_an_address_sends_nothing_of_its_own() {
    let ran = Run { settings: nameless(), ..Run::new(&[], 3_000) }.run();
    assert_eq!(ran.said, []);
    assert_eq!(ran.config.node, None);
    assert!(ran.unfed_us <= 25_000);
}

/// Somebody asks the node something.
fn asked() -> [(u64, u16, Vec<u8>); 1] {
    [(1_000, GET_INFO_PORT, Vec::new())]
}

/// Frames as they are decided at 240 Hz.
fn frames(ms: u64, status: &mut Status) {
    status.decided_frames = decided(ms);
}

#[test]
fn a_new_firmware_confirms_once_when_it_has_decided_and_been_heard() {
    let run = update::Run::OnTrial;
    let ran = Run { run, meanwhile: &with_status(frames), ..Run::new(&asked(), 14_000) }.run();
    let due_ms = u64::from(CONFIRM_FRAMES) * 1000 / 240;
    assert_eq!(ran.log.confirmed_ms.len(), 1);
    assert!((due_ms..due_ms + 25).contains(&ran.log.confirmed_ms[0]), "{:?}", ran.log.confirmed_ms);
    let ran = Run { meanwhile: &with_status(frames), ..Run::new(&asked(), 14_000) }.run();
    assert!(ran.log.confirmed_ms.is_empty(), "it was not on trial");
}

#[test]
fn a_new_firmware_that_decides_receives_or_senses_nothing_or_is_not_received_does_not_confirm() {
    let run = update::Run::OnTrial;
    let blind = with_status(|ms, status| {
        frames(ms, status);
        status.sensor_health = [SensorHealth(health::PIEZO_MISSING | health::XL_MISSING); 3];
    });
    // Heartbeats that wait for a bus have not been received.
    let off = |ms: u64, shared: &Shared<NoopRawMutex>, bus: &Bus| {
        shared.update_status(|status| frames(ms, status));
        bus.off.set(ms < 30_000);
    };
    let withdrawn = with_status(|ms, status| {
        frames(ms, status);
        status.lost_services = (ms / 1_000) as u32;
    });
    for (run, why) in [
        (Run { run, meanwhile: &withdrawn, ..Run::new(&asked(), 14_000) }, "each one taken back"),
        (Run { run, ..Run::new(&asked(), 14_000) }, "no frames"),
        (Run { run, meanwhile: &with_status(frames), ..Run::new(&[], 14_000) }, "it has received nothing"),
        (Run { run, meanwhile: &blind, ..Run::new(&asked(), 14_000) }, "no sensor delivers"),
        (Run { run, meanwhile: &off, ..Run::new(&asked(), 29_900) }, "nobody received one"),
    ] {
        assert!(run.run().log.confirmed_ms.is_empty(), "{why}");
    }
    let ran = Run { run, meanwhile: &off, ..Run::new(&asked(), 40_000) }.run();
    assert!(ran.log.confirmed_ms[0] >= 30_000, "{:?}", ran.log.confirmed_ms);
}

#[test]
fn a_board_says_what_it_has_to_say_once_it_has_an_address() {
    let version = ImageVersion { major: 1, minor: 2, patch: 3 };
    let notices = vec![
        Notice::DevelopmentKey,
        Notice::FirmwareStays(version, Refusal::NoBootloader),
        Notice::Model(SlotModel::BuiltIn(Refusal::WrongHash)),
    ];
    let mut said: Vec<_> = notices.iter().map(|notice| notice.to_string()).collect();
    // And by which calibration its array is read.
    said.push("calibration 0: none".to_owned());
    let ran = Run { notices: notices.clone(), ..Run::new(&[], 1_500) }.run();
    assert_eq!(ran.records(), said);
    let severities: Vec<_> = ran.messages(RECORD_PORT).iter().map(|(_, _, bytes)| bytes[7]).collect();
    assert_eq!(severities, [3, 3, 4, 2]);
    let ran = Run { notices, settings: nameless(), ..Run::new(&[], 1_500) }.run();
    assert_eq!(ran.records(), Vec::<String>::new());
}
