//! List and Access.

use std::collections::BTreeSet;

use proptest::prelude::*;
use slipsense::node::{ACCESS_PORT, LIST_PORT, REGISTERS};
use slipsense::settings::{Setting, TABLE};

use super::{ask, hear, node, records, request};

pub fn access(name: &str, value: &[u8]) -> Vec<u8> {
    [&[name.len() as u8], name.as_bytes(), value].concat()
}

/// A value of one kind with 8-bit length, or 16-bit for single bytes.
fn natural8(values: &[u8]) -> Vec<u8> {
    [&[11, values.len() as u8, 0], values].concat()
}

fn natural32(values: &[u32]) -> Vec<u8> {
    let bytes = values.iter().flat_map(|value| value.to_le_bytes());
    [9, values.len() as u8].into_iter().chain(bytes).collect()
}

#[test]
fn the_list_has_every_register_once_and_each_answers() {
    let mut node = node();
    let mut names = Vec::new();
    for index in 0u16.. {
        let answer = ask(&mut node, LIST_PORT, (index % 32) as u8, &index.to_le_bytes(), 0).unwrap();
        let name = String::from_utf8(answer[1..1 + usize::from(answer[0])].to_vec()).unwrap();
        if name.is_empty() {
            break;
        }
        names.push(name);
    }
    assert_eq!(names.len(), REGISTERS);
    assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), REGISTERS);
    for (index, name) in names.iter().enumerate() {
        let answer = ask(&mut node, ACCESS_PORT, (index % 32) as u8, &access(name, &[0]), 0).unwrap();
        assert!(answer[8] != 0, "{name} has a value");
        let writable = TABLE.iter().any(|definition| definition.name == name);
        assert_eq!(answer[7] & 1 != 0, writable, "{name}");
    }
    let nothing = ask(&mut node, ACCESS_PORT, 0, &access("no.such.register", &[0]), 0).unwrap();
    assert_eq!(nothing[7..9], [0, 0]);
}

#[test]
fn uptime_and_errors_of_the_memories_are_registers() {
    let mut node = node();
    (node.status.flash_errors, node.status.ram_errors) = ([300, 1], [2, 70_000]);
    node.poll(5_999_999);
    let uptime =
        ask(&mut node, ACCESS_PORT, 2, &access("slipsense.status.uptime_s", &[0]), 5_999_999).unwrap();
    assert_eq!(uptime[8..14], natural32(&[5]));
    for (id, name, errors) in [(0, "flash_errors", [300, 1]), (1, "ram_errors", [2, 70_000])] {
        let name = format!("slipsense.status.{name}");
        let answer = ask(&mut node, ACCESS_PORT, id, &access(&name, &[0]), 0).unwrap();
        assert_eq!(answer[8..18], natural32(&errors));
    }
}

#[test]
fn writing_changes_the_setting_and_says_so() {
    let mut node = node();
    assert_eq!(node.take_changed(), None);
    let answer = ask(&mut node, ACCESS_PORT, 0, &access("slipsense.sensors", &natural8(&[3])), 0).unwrap();
    // Time unknown, mutable and persistent, one natural8: 3.
    assert_eq!(answer[..12], [0, 0, 0, 0, 0, 0, 0, 3, 11, 1, 0, 3]);
    assert_eq!((node.settings().sensors(), node.take_changed()), (3, Some(Setting::Sensors)));
    assert_eq!(node.take_changed(), None);
    // Another kind of number will do, if it is in range.
    ask(&mut node, ACCESS_PORT, 1, &access("slipsense.sensors", &natural32(&[2])), 0).unwrap();
    assert_eq!(node.settings().sensors(), 2);
    // Three frames.
    let mask: Vec<u32> = (0..32).map(|row| 1 << row).collect();
    ask(&mut node, ACCESS_PORT, 2, &access("slipsense.sensor.1.mask", &natural32(&mask)), 0).unwrap();
    assert_eq!(node.settings().taxel_mask(1).0.to_vec(), mask);
    assert_eq!(node.settings().taxel_mask(0).0, [0; 32]);
    // The three that the standard derives.
    for (transfer, (suffix, value)) in [("<", 3), (">", 1), ("=", 1)].into_iter().enumerate() {
        let name = format!("slipsense.sensors{suffix}");
        let answer = ask(&mut node, ACCESS_PORT, 3 + transfer as u8, &access(&name, &[0]), 0).unwrap();
        assert_eq!(answer[7..12], [2, 11, 1, 0, value], "{name}");
    }
    // Where the least is not the default.
    let least = ask(&mut node, ACCESS_PORT, 6, &access("uavcan.node.id>", &[0]), 0).unwrap();
    assert_eq!(least[7..13], [2, 10, 1, 0, 0, 0]);
}

#[test]
fn what_is_refused_stays_and_is_named() {
    let mut node = node();
    for (transfer, (name, value, text)) in (0u8..).zip([
        ("slipsense.sensors", natural8(&[4]), "slipsense.sensors: element 0 is 4, allowed are 1 to 3"),
        ("slipsense.sensors", natural8(&[1, 1]), "slipsense.sensors: 2 elements, need 1"),
        ("slipsense.sensors", vec![1, 1, 0, b'3'], "slipsense.sensors: {not}"),
        ("slipsense.status.bus_off", natural32(&[0]), "slipsense.status.bus_off: {not}"),
        // A natural16: 300.
        (
            "uavcan.node.id",
            vec![10, 1, 44, 1],
            "uavcan.node.id: element 0 is 300, allowed are 0 to 127 and 65535",
        ),
        ("slipsense.sensors", vec![8, 1, 0, 0, 0, 0, 0, 0, 0, 255], "slipsense.sensors: {not}"),
    ]) {
        let before = node.settings().clone();
        hear(&mut node, request(ACCESS_PORT, transfer, &access(name, &value)), 0);
        assert_eq!(records(&mut node), [text.replace("{not}", "cannot be written, or not with this type")]);
        assert_eq!((node.take_changed(), node.settings()), (None, &before));
    }
}

#[test]
fn a_request_that_is_cut_short_writes_nothing() {
    // In one frame, so that padding to a CAN length is all that is added.
    let whole = access("slipsense.sensor.order", &natural8(&[0, 2, 1]));
    let mut node = node();
    for length in 0..whole.len() {
        // The padding is zeros: connector 0 would be there twice.
        let before = node.settings().clone();
        let _ = ask(&mut node, ACCESS_PORT, (length % 32) as u8, &whole[..length], 0);
        assert_eq!(node.settings(), &before, "{length} bytes");
    }
    // 3 s later transfer identifiers may begin anew.
    ask(&mut node, ACCESS_PORT, 31, &whole, 3_000_000).unwrap();
    assert_eq!(node.settings().sensor_order(), [0, 2, 1]);
}

proptest! {
    #[test]
    fn an_answer_holds_what_the_setting_holds(index in 0..TABLE.len(), values in proptest::collection::vec(any::<u32>(), 1..33)) {
        let definition = &TABLE[index];
        let mut node = node();
        let answer = ask(&mut node, ACCESS_PORT, 0, &access(definition.name, &natural32(&values)), 0).unwrap();
        let bytes = definition.kind.bytes();
        let header = if bytes == 1 { 3 } else { 2 };
        let held: Vec<i64> = match definition.kind {
            slipsense::settings::Kind::Bit => vec![i64::from(answer[8 + header])],
            kind => answer[8 + header..].chunks(bytes).take(definition.default.len()).map(|b| kind.read(b).unwrap()).collect(),
        };
        prop_assert_eq!(node.settings().get(definition.setting), &held);
        let wanted: Vec<i64> = values.iter().map(|&value| value.into()).collect();
        let valid = slipsense::settings::check(definition.setting, &wanted).is_ok();
        prop_assert_eq!(held, if valid { wanted } else { definition.default.to_vec() });
    }
}
