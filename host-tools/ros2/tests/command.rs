//! The command: what it refuses, and that nothing is left behind then. What its bags hold is checked by rosbags in
//! `tests/python/check_ros2.py`.

use std::path::Path;
use std::process::{Command, Output};

use slipsense::{health, wire};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::log_file::{self, Format, Record};

/// A frame of a message that is none of the module's.
const NOTHING_OF_OURS: &str = "(0000000000.000000) can0 1BFFFFFF##100\n";

fn slipsense_ros2(line: &str, domain: &str, folder: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_slipsense-ros2"));
    command.args(line.split(' ')).current_dir(folder).env("ROS_DOMAIN_ID", domain).output().unwrap()
}

#[test]
fn what_cannot_be_done_is_named_and_leaves_nothing() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("bus.log"), NOTHING_OF_OURS).unwrap();
    std::fs::create_dir(dir.path().join("there")).unwrap();
    let cases = [
        ("bag bus.log bag", "", ["bus.log", "no slip or raw message"]),
        ("bag bus.log there", "", ["there: ", "is there already"]),
        ("bag bus.txt bag", "", ["bus.txt", ".mcap"]),
        ("bag none.log bag", "", ["none.log", "cannot read"]),
        ("node none.log", "", ["none.log", "cannot read"]),
        ("node bus.log --domain-id 233", "", ["--domain-id", "232"]),
        ("node bus.log", "x", ["ROS_DOMAIN_ID", "\"x\""]),
    ];
    let namespaces = ["slipsense", "/", "/a//b", "/a/", "/1", "/a__b", "/a-b"];
    let namespaces = namespaces.map(|wrong| format!("bag bus.log bag --namespace {wrong}"));
    let wrong = namespaces.iter().map(|line| (line.as_str(), "", ["--namespace", "must be /NAME"]));
    for (line, domain, words) in cases.into_iter().chain(wrong) {
        let output = slipsense_ros2(line, domain, dir.path());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {said}");
        assert!(words.iter().all(|words| said.contains(words)), "{line}: {words:?} are not in: {said}");
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 2, "{line}");
    }
}

#[test]
fn a_recording_that_was_cut_short_is_said() {
    let dir = tempfile::tempdir().unwrap();
    let frame = wire::Transmitter::new(wire::NodeId::DEFAULT).slip(&wire::SlipMessage::default());
    let entry = LogEntry { timestamp_us: 1_000_000, interface: "can0".to_owned(), frame };
    let path = dir.path().join("bus.mcap");
    log_file::write(&path, Format::Mcap, |sink| sink.put(&Record::Frame(entry))).unwrap();
    let whole = std::fs::read(&path).unwrap();
    std::fs::write(&path, &whole[..whole.len() - 20]).unwrap();
    for line in ["bag bus.mcap bag", "bag bus.mcap again --json"] {
        let output = slipsense_ros2(line, "", dir.path());
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success() && said.contains("the file was cut short"), "{said}");
    }
}

/// The bits are written a second time for ROS.
#[test]
fn the_messages_have_the_bits_of_the_wire() {
    let constants = |text: &'static str, prefix: &str| -> Vec<(&str, u8)> {
        let of_line = |line: &'static str| line.strip_prefix("uint8 ")?.strip_prefix(prefix)?.split_once('=');
        let number = |text: &str| text.split_whitespace().next().unwrap().parse().unwrap();
        text.lines().filter_map(of_line).map(|(name, value)| (name, number(value))).collect()
    };
    let contact = include_str!("../slipsense_msgs/msg/SensorContact.msg");
    let health = [
        ("PIEZO_MISSING", health::PIEZO_MISSING),
        ("XL_MISSING", health::XL_MISSING),
        ("XL_WARMING_UP", health::XL_WARMING_UP),
        ("XL_CLIPPED", health::XL_CLIPPED),
        ("TAXELS_SATURATED", health::TAXELS_SATURATED),
        ("XL_SAMPLES_DROPPED", health::XL_SAMPLES_DROPPED),
        ("NO_MODEL", health::NO_MODEL),
        ("TAXELS_MASKED", health::TAXELS_MASKED),
    ];
    assert_eq!(constants(contact, "HEALTH_"), health);
    let slip = include_str!("../slipsense_msgs/msg/Slip.msg");
    let invalid = [
        ("NO_MODEL", wire::INVALID_NO_MODEL),
        ("STARTING", wire::INVALID_STARTING),
        ("NO_SENSOR", wire::INVALID_NO_SENSOR),
        ("MEMORY", wire::INVALID_MEMORY),
        ("NETWORK", wire::INVALID_NETWORK),
        ("OTHER_MODEL", wire::INVALID_OTHER_MODEL),
    ];
    assert_eq!(constants(slip, "INVALID_"), invalid);
    let degraded = [
        ("MISSING", wire::DEGRADED_MISSING),
        ("FROZEN", wire::DEGRADED_FROZEN),
        ("NOT_CALIBRATED", wire::DEGRADED_NOT_CALIBRATED),
        ("POINT", wire::DEGRADED_POINT),
        ("LATE", wire::DEGRADED_LATE),
        ("SELF_TEST", wire::DEGRADED_SELF_TEST),
    ];
    assert_eq!(constants(slip, "DEGRADED_"), degraded);
}
