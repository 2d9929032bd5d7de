//! ExecuteCommand, GetInfo, heartbeat, records.

use slipsense::calibration::{Request, What};
use slipsense::health::{self, Condition, SensorHealth, Status};
use slipsense::node::{
    Action, CALIBRATE, COMMAND_PORT, COMMAND_TIMEOUT_US, FACTORY_RESET, GET_INFO_PORT, HEARTBEAT_PORT,
    IDENTIFY, Mode, NODE_NAME, Node, RECORD_TEXT_MAX, RESTART, SCALE_GAIN, SELF_TEST, STORE, STORE_PAUSE_US,
    Severity, Version, vendor_status,
};
use slipsense::settings::{Setting, Settings};
use slipsense::wire::{Frames, NodeId, Priority, ServiceId, ServiceRole, TransferId};

use super::{NODE, TOOL, ask, hear, identity, node, records, request, said};

/// Status and text of an answer to a command.
fn reply(answer: &[u8]) -> (u8, &str) {
    (answer[0], std::str::from_utf8(&answer[2..2 + usize::from(answer[1])]).unwrap())
}

pub fn command(number: u16, parameter: &[u8]) -> Vec<u8> {
    [&number.to_le_bytes()[..], &[parameter.len() as u8], parameter].concat()
}

#[test]
fn get_info_says_what_the_node_is() {
    let answer = ask(&mut node(), GET_INFO_PORT, 7, &[], 0).unwrap();
    assert_eq!(answer[..6], [1, 0, 1, 2, 0, 1]);
    assert_eq!(answer[6..14], 0x0123_4567_89AB_CDEFu64.to_le_bytes());
    assert_eq!(answer[14..30], *b"0123456789abcdef");
    assert_eq!(answer[30], NODE_NAME.len() as u8);
    assert_eq!(&answer[31..50], NODE_NAME.as_bytes());
    let version = format!("{}.{}", Version::SOFTWARE.major, Version::SOFTWARE.minor);
    assert_eq!(Some((version.as_str(), "0")), env!("CARGO_PKG_VERSION").rsplit_once('.'));
    // One hash, that of the model, then no certificate.
    assert_eq!(answer[50..60], [1, 7, 6, 5, 4, 3, 2, 1, 0, 0]);
}

#[test]
fn commands_become_actions_and_answers() {
    let mut node = node();
    assert_eq!(ask(&mut node, COMMAND_PORT, 0, &command(RESTART, b""), 0).unwrap()[0], 0);
    assert_eq!(ask(&mut node, COMMAND_PORT, 1, &command(IDENTIFY, b""), 0).unwrap()[0], 0);
    assert_eq!((node.take_action(), node.take_action()), (Some(Action::Restart), Some(Action::Identify)));
    // Power off is not for us; a path is missing.
    let answer = ask(&mut node, COMMAND_PORT, 2, &command(65_534, b""), 0).unwrap();
    assert_eq!(reply(&answer), (3, "no such command"));
    assert_eq!(ask(&mut node, COMMAND_PORT, 3, &command(65_533, b""), 0).unwrap()[0], 4);
    assert_eq!(node.take_action(), None);
}

#[test]
fn a_store_is_answered_when_it_is_done() {
    let mut node = node();
    assert_eq!(ask(&mut node, COMMAND_PORT, 0, &command(STORE, b""), 0), None);
    assert_eq!(node.take_action(), Some(Action::Store));
    // Not two at a time.
    assert_eq!(ask(&mut node, COMMAND_PORT, 1, &command(SELF_TEST, b""), 0).unwrap()[0], 5);
    node.command_done(Ok(()));
    let answers = said(&mut node);
    assert_eq!((answers.len(), answers[0].1, &answers[0].2[..2]), (1, 0, &[0, 0][..]));

    assert_eq!(ask(&mut node, COMMAND_PORT, 2, &command(SELF_TEST, b""), 0), None);
    let why = "sensors 0 to 2: accelerometers answer; no array";
    node.command_done(Err(why));
    assert_eq!(reply(&said(&mut node)[0].2), (1, &why[..46]), "cut where the standard cuts");

    // A board that never says.
    assert_eq!(ask(&mut node, COMMAND_PORT, 3, &command(STORE, b""), STORE_PAUSE_US), None);
    node.poll(STORE_PAUSE_US + COMMAND_TIMEOUT_US);
    assert!(said(&mut node).iter().any(|(_, transfer, bytes)| *transfer == 3 && bytes[0] == 1));
    // What it says late answers no other command.
    let later_us = STORE_PAUSE_US + COMMAND_TIMEOUT_US + 1;
    let answer = ask(&mut node, COMMAND_PORT, 4, &command(SELF_TEST, b""), later_us).unwrap();
    assert_eq!(reply(&answer).1, "another command is not done yet");
    node.command_done(Ok(()));
    assert!(said(&mut node).is_empty());
    assert_eq!(ask(&mut node, COMMAND_PORT, 5, &command(SELF_TEST, b""), later_us), None);
    node.command_done(Ok(()));
    assert_eq!((said(&mut node)[0].1, node.take_action()), (5, Some(Action::SelfTest)));
}

#[test]
fn stores_and_calibrations_come_ten_seconds_apart() {
    let mut node = node();
    let mut status = |transfer: u8, number, parameter: &[u8], now_us| {
        let payload = command(number, parameter);
        let answer = ask(&mut node, COMMAND_PORT, transfer, &payload, now_us);
        let action = node.take_action();
        assert_eq!(action.is_some(), answer.is_none());
        node.command_done(Ok(()));
        said(&mut node);
        answer.map(|answer| reply(&answer).1.to_owned())
    };
    let (store, calibration) = ("wait ten seconds after a store", "wait ten seconds after a calibration");
    assert_eq!(status(0, STORE, b"", 0), None);
    assert_eq!(status(1, CALIBRATE, b"0 1", 1), None);
    assert_eq!(status(2, FACTORY_RESET, b"", STORE_PAUSE_US - 1).as_deref(), Some(store));
    assert_eq!(status(3, SCALE_GAIN, b"0 2000", STORE_PAUSE_US).as_deref(), Some(calibration));
    assert_eq!(status(4, FACTORY_RESET, b"", STORE_PAUSE_US), None);
    assert_eq!(status(5, SCALE_GAIN, b"0 2000", STORE_PAUSE_US + 1), None);
    assert_eq!(status(6, STORE, b"", STORE_PAUSE_US + 2).as_deref(), Some(store));
}

#[test]
fn a_calibration_names_an_array_and_a_number() {
    let action = |number, parameter: &str| {
        let mut node = node();
        let answer = ask(&mut node, COMMAND_PORT, 0, &command(number, parameter.as_bytes()), 0);
        node.take_action().ok_or_else(|| answer.unwrap()[0])
    };
    let request = |sensor, what| Ok(Action::Calibrate(Request { sensor, what }));
    assert_eq!(action(CALIBRATE, "0 10"), request(0, What::Measure(10)));
    assert_eq!(action(CALIBRATE, "2 0"), request(2, What::Forget));
    assert_eq!(action(SCALE_GAIN, "255 65535"), request(255, What::Scale(65_535)));
    for bad in [
        "", "0", "0 ", " 10", "0  10", "0 1 2", "0 10 ", "0 x", "0 -1", "256 1", "0 256", "0 65536", ": 1",
        "0 :",
    ] {
        assert_eq!(action(CALIBRATE, bad), Err(4), "{bad}");
    }
}

#[test]
fn a_factory_reset_gives_the_defaults_and_tells_the_tasks() {
    let mut node = Node::new(identity(), crate::settings(&[(Setting::Sensors, &[3])]));
    hear(&mut node, request(COMMAND_PORT, 0, &command(FACTORY_RESET, b"")), 0);
    assert_eq!(node.take_action(), Some(Action::FactoryReset));
    assert_eq!(node.take_changed(), Some(Setting::Sensors));
    assert_eq!((node.take_changed(), node.settings()), (None, &Settings::new()));
}

#[test]
fn the_heartbeat_says_how_the_board_is() {
    let mut node = Node::new(identity(), Settings::new());
    let beat = |node: &mut Node, now: u64| {
        node.poll(now);
        let said = said(node);
        assert_eq!(said.len(), 1, "one heartbeat");
        let TransferId::Message(id) = said[0].0 else { panic!("{:?}", said[0]) };
        assert_eq!((id.port, id.node), (HEARTBEAT_PORT, NODE));
        <[u8; 7]>::try_from(&said[0].2[..7]).unwrap()
    };
    assert_eq!(beat(&mut node, 0), [0, 0, 0, 0, 0, Mode::Initialization as u8, 0]);
    node.set_operational();
    assert_eq!(node.poll(999_999), 1_000_000);
    assert!(node.is_drained());
    assert_eq!(beat(&mut node, 1_000_000), [1, 0, 0, 0, 0, 0, 0]);
    // A late one does not move those that follow.
    assert_eq!(beat(&mut node, 2_000_300)[0], 2);
    assert_eq!(node.poll(2_000_300), 3_000_000);
    // Seconds without a turn: one heartbeat.
    assert_eq!(beat(&mut node, 4_000_000)[0], 4);
    assert_eq!(node.poll(4_000_000), 5_000_000);
    assert!(node.is_drained());
    assert_eq!(beat(&mut node, 6_500_000)[0], 6);
    assert_eq!(node.poll(6_500_000), 7_500_000);
    node.status.late_frames = 1;
    assert_eq!(beat(&mut node, 7_600_000)[4..], [Condition::Advisory as u8, 0, vendor_status::LATE_FRAMES]);
    node.status.sensors = 2;
    node.status.sensor_health = [0, health::XL_MISSING, 255].map(SensorHealth);
    assert_eq!((node.health(), beat(&mut node, 8_600_000)[6]), (Condition::Caution, 1 | 4));
    (node.status.sensor_health, node.status.frozen) = ([SensorHealth(0); 3], true);
    assert_eq!((node.health(), beat(&mut node, 9_600_000)[6]), (Condition::Caution, 1 | 4));
    node.status.sensor_health = [SensorHealth(health::PIEZO_MISSING | health::XL_MISSING); 3];
    assert_eq!(node.health(), Condition::Warning);
    node.status.sensor_health = [SensorHealth(health::NO_MODEL); 3];
    assert_eq!(node.health(), Condition::Warning);
    // Each counter by itself.
    type Counter = fn(&mut Status) -> &mut u32;
    let counters: [(Counter, u8); 6] = [
        (|status: &mut Status| &mut status.dropped_frames, vendor_status::LATE_FRAMES),
        (|status| &mut status.dropped_raw, vendor_status::RAW_DROPPED),
        (|status| &mut status.broken_raw, vendor_status::RAW_DROPPED),
        (|status| &mut status.lost_received, vendor_status::RAW_DROPPED),
        (|status| &mut status.bus_offs, vendor_status::BUS_OFF),
        (|status| &mut status.last_panic, vendor_status::PANICKED),
    ];
    for (index, (count, flag)) in counters.into_iter().enumerate() {
        node.status = Status::new();
        *count(&mut node.status) = 1;
        assert_eq!(beat(&mut node, 20_000_000 + 1_000_000 * index as u64)[6], flag, "{index}");
    }
}

#[test]
fn records_are_cut_at_a_character_and_give_way() {
    let mut node = node();
    let long = "ä".repeat(100);
    node.report(Severity::Info, format_args!("x{long}"));
    assert_eq!(records(&mut node), [format!("x{}", "ä".repeat(55))]);
    let full = "r".repeat(RECORD_TEXT_MAX);
    node.report(Severity::Info, format_args!("{full}s"));
    assert_eq!(records(&mut node), [full]);
    for _ in 0..40 {
        node.report(Severity::Info, format_args!("short"));
    }
    assert!(!node.try_report(Severity::Info, format_args!("again later")));
    assert_eq!(records(&mut node).len(), 17);
    assert_eq!(node.counters().dropped_transfers, 23);
    assert!(node.try_report(Severity::Info, format_args!("again later")));
    assert_eq!(records(&mut node), ["again later"]);
    // Answers are dropped whole and counted when nobody takes frames.
    for transfer in 0..40 {
        hear(&mut node, request(GET_INFO_PORT, transfer % 32, &[]), u64::from(transfer) * 3_000_000);
    }
    // The heartbeat has a place of its own.
    node.poll(200_000_000);
    assert_eq!((said(&mut node).len(), node.counters().dropped_transfers), (33, 23 + 8));
    // What waited while there was no bus.
    node.poll(300_000_000);
    hear(&mut node, request(GET_INFO_PORT, 5, &[]), 300_000_000);
    node.discard_frames();
    assert_eq!((node.is_drained(), node.counters().dropped_transfers), (true, 23 + 10));
}

#[test]
fn a_transfer_that_gives_way_to_another_sender_is_counted() {
    let mut node = node();
    let call = |source| {
        let (priority, role, source) =
            (Priority::Nominal, ServiceRole::Request, NodeId::new(source).unwrap());
        let id = ServiceId { priority, role, port: GET_INFO_PORT, destination: NODE, source };
        Frames::new(id, 0, &[0; 300]).next()
    };
    hear(&mut node, (20..26).filter_map(call), 0);
    assert_eq!(node.counters().transfer_errors, 0);
    hear(&mut node, call(26), 1);
    assert_eq!(node.counters().transfer_errors, 1);
}

#[test]
fn an_answer_never_goes_before_the_slip_message() {
    for (asked, answered) in [
        (Priority::Exceptional, Priority::Fast),
        (Priority::Immediate, Priority::Fast),
        (Priority::Fast, Priority::Fast),
        (Priority::Optional, Priority::Optional),
    ] {
        let mut node = node();
        let (role, port) = (ServiceRole::Request, GET_INFO_PORT);
        let id = ServiceId { priority: asked, role, port, destination: NODE, source: TOOL };
        hear(&mut node, Frames::new(id, 0, &[]), 0);
        let TransferId::Service(answer) = said(&mut node)[0].0 else { panic!("no answer") };
        assert_eq!(answer.priority, answered);
        assert!(answer.priority > slipsense::wire::SLIP_PRIORITY);
    }
}

#[test]
fn damaged_settings_are_reported_when_the_node_starts() {
    let mut identity = identity();
    identity.settings.damage.settings = 1 << Setting::Sensors as u8 | 1 << Setting::PlugAndPlay as u8;
    let mut node = Node::new(identity, Settings::new());
    node.poll(0);
    assert_eq!(records(&mut node), ["settings damaged, default for slipsense.sensors slipsense.pnp"]);
    assert_eq!(node.health(), Condition::Caution);
    node.poll(10_000_000);
    assert_eq!(records(&mut node), [""; 0]);
}
