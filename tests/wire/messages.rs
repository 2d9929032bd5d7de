//! Messages to bytes and back.

use proptest::prelude::*;
use slipsense::fixed::Q;
use slipsense::params::{ACTIVE_TAXELS, TAXELS};
use slipsense::sensor::{PiezoFrame, SensorInput, XlSample};
use slipsense::wire::{
    CanFrame, DEGRADED_NOT_CALIBRATED, DecodeError, FD_LENGTHS, INVALID_NO_MODEL, NodeId, Origin,
    RAW_BYTES_MAX, RAW_XL_MAX, RawBuffer, RawFrame, RawMessage, Received, Receiver, SLIP_BYTES,
    SensorContact, SlipMessage, Transmitter, wire_logit,
};

use super::{NODE, expected, frame, raw};

fn contact() -> impl Strategy<Value = SensorContact> {
    let fields = (any::<u8>(), 0u32..1 << 22, 0u16..1 << 10, any::<[u16; 2]>(), any::<i8>(), any::<u8>());
    fields.prop_map(|(health, sum, area, [row, col], axis_deg, elongation)| SensorContact {
        health,
        sum,
        area,
        centroid_row: Q::from_bits(row),
        centroid_col: Q::from_bits(col),
        axis_deg,
        elongation: Q::from_bits(elongation),
    })
}

fn slip() -> impl Strategy<Value = SlipMessage> {
    let decision = (0u8..3, any::<[bool; 3]>(), any::<[i16; 4]>(), any::<[u8; 4]>(), 0u8..4, any::<u16>());
    let contacts = proptest::array::uniform3(contact());
    (0u64..1 << 56, any::<u32>(), decision, contacts).prop_map(
        |(timestamp_us, sequence, decision, contact)| {
            let (class, [slip, may_begin, locked], logits, bytes, sensors, configuration) = decision;
            let [a, b, c, log_odds] = logits.map(Q::from_bits);
            let [invalid, degraded, starts, late_frames] = bytes;
            SlipMessage {
                timestamp_us,
                sequence,
                class,
                slip,
                may_begin,
                sensors,
                locked,
                invalid,
                degraded,
                starts,
                configuration,
                late_frames,
                logits: [a, b, c],
                log_odds,
                contact,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn slip_messages_round_trip(message in slip()) {
        prop_assert_eq!(SlipMessage::decode(NODE, &message.encode(NODE)), Ok(message));
        let frame = Transmitter::new(NODE).slip(&message);
        prop_assert_eq!(frame.data().len(), 64);
        prop_assert_eq!(Receiver::new(NODE).accept(&frame), Ok(Some(Received::Slip(message))));
    }

    #[test]
    fn raw_frames_round_trip(parts in raw()) {
        let mut buffer = RawBuffer::new();
        let frames: Vec<_> = Transmitter::new(NODE).raw(&frame(&parts), &mut buffer).collect();
        prop_assert!((23..=29).contains(&frames.len()));
        prop_assert!(frames.iter().all(|frame| FD_LENGTHS.contains(&(frame.data().len() as u8))));
        let mut receiver = Receiver::new(NODE);
        let (last, before) = frames.split_last().unwrap();
        for frame in before {
            prop_assert_eq!(receiver.accept(frame), Ok(None));
        }
        prop_assert_eq!(receiver.accept(last), Ok(Some(Received::Raw(expected(&parts)))));
    }
}

/// Every field at its largest and smallest, beyond its range where the type allows it.
#[test]
fn fields_saturate() {
    let contact = SensorContact {
        health: 255,
        sum: u32::MAX,
        area: u16::MAX,
        centroid_row: Q::from_bits(u16::MAX),
        centroid_col: Q::from_bits(0),
        axis_deg: i8::MIN,
        elongation: Q::from_bits(255),
    };
    let message = SlipMessage {
        timestamp_us: u64::MAX,
        sequence: u32::MAX,
        class: 2,
        slip: true,
        sensors: 255,
        contact: [contact; 3],
        ..SlipMessage::default()
    };
    let of_contact = SensorContact { sum: (1 << 22) - 1, area: 1023, ..contact };
    let sent = SlipMessage { timestamp_us: (1 << 56) - 1, sensors: 3, contact: [of_contact; 3], ..message };
    assert_eq!(SlipMessage::decode(NODE, &message.encode(NODE)), Ok(sent));
    // By one too large.
    let contact = SensorContact { sum: 1 << 22, area: 1 << 10, ..contact };
    let beyond = SlipMessage { timestamp_us: 1 << 56, sensors: 4, contact: [contact; 3], ..message };
    assert_eq!(SlipMessage::decode(NODE, &beyond.encode(NODE)), Ok(sent));
    let logits = [i32::MIN, -131_073, -1, 1, 2, 131_069, 131_070, i32::MAX].map(Q::from_bits);
    let sent = [-32_768, -32_768, 0, 0, 1, 32_767, 32_767, 32_767].map(Q::from_bits);
    assert_eq!(logits.map(wire_logit), sent);

    let name = "slipsense.Slip";
    let refused = DecodeError::OutOfRange { message: name, field: "class_index", value: 3, max: 2 };
    for class in 3..=255 {
        assert_eq!(SlipMessage::decode(NODE, &SlipMessage { class, ..message }.encode(NODE)), Err(refused));
    }

    let full = PiezoFrame::from_scan([u16::MAX; TAXELS]);
    assert_eq!(full.sum() as usize, ACTIVE_TAXELS * 4_095);
    let samples: Vec<XlSample> = (0..400).map(|i| [i, i16::MIN, i16::MAX]).collect();
    let parts = (u64::MAX, u32::MAX, 2, 255, Some(full), Some(samples), u32::MAX);
    let mut buffer = RawBuffer::new();
    let bytes = frame(&parts).encode(&mut buffer);
    assert_eq!(bytes.len(), RAW_BYTES_MAX);
    let decoded = RawMessage::decode(bytes).unwrap();
    assert_eq!(decoded, RawMessage { timestamp_us: (1 << 56) - 1, ..expected(&parts) });
    assert_eq!((decoded.xl_dropped, decoded.xl.len()), (255, RAW_XL_MAX));
}

/// Bytes written by hand from the DSDL definitions, not by this code.
#[test]
fn layouts_are_those_of_the_definitions() {
    let contact = |n: u8| SensorContact {
        health: n,
        sum: 0x03_0201 + u32::from(n),
        area: 0x0104,
        centroid_row: Q::from_bits(0x0706),
        centroid_col: Q::from_bits(0x0908),
        axis_deg: -2,
        elongation: Q::from_bits(0x0A),
    };
    let message = SlipMessage {
        timestamp_us: 0x07_0605_0403_0201,
        sequence: 0x0B0A_0908,
        class: 2,
        slip: true,
        may_begin: true,
        sensors: 3,
        locked: true,
        invalid: 13,
        degraded: 14,
        starts: 15,
        configuration: 0x1110,
        late_frames: 18,
        logits: [1, -1, 0x0201].map(Q::from_bits),
        log_odds: Q::from_bits(0x0403),
        contact: [contact(0), contact(16), contact(32)],
    };
    #[rustfmt::skip]
    let bytes = [
        1, 2, 3, 4, 5, 6, 7,  8, 9, 10, 11,  0b0111_1110,  13, 14, 15,  16, 17,  18,
        1, 0,  255, 255,  1, 2,  3, 4,
        0,  0x01, 2, 3, 0x41,  6, 7,  8, 9,  254,  10,
        16, 0x11, 2, 3, 0x41,  6, 7,  8, 9,  254,  10,
        32, 0x21, 2, 3, 0x41,  6, 7,  8, 9,  254,  10,
    ];
    assert_eq!(message.encode(NODE)[..59], bytes);

    // Version 1.0, as recordings have it: `alarm` is the flag to act on, `slip` the class.
    #[rustfmt::skip]
    let bytes = [
        1, 2, 3, 4, 5, 6, 7,  8, 9, 10, 11,  0b0001_1110,  12, 13,
        4, 0, 0, 0,  252, 255, 255, 255,  0, 0, 2, 0,
        0,  0x01, 2, 3,  4, 1,  6, 7,  8, 9,  254,  10,
        16, 0x11, 2, 3,  4, 1,  6, 7,  8, 9,  254,  10,
        32, 0x21, 2, 3,  4, 1,  6, 7,  8, 9,  254,  10,
    ];
    let old = SlipMessage {
        timestamp_us: message.timestamp_us,
        sequence: message.sequence,
        class: 2,
        may_begin: true,
        sensors: 3,
        late_frames: 12,
        degraded: DEGRADED_NOT_CALIBRATED,
        logits: [1, -1, i16::MAX].map(Q::from_bits),
        log_odds: Q::from_bits(i16::MIN),
        contact: message.contact,
        ..SlipMessage::default()
    };
    let recorded = CanFrame::new(0x0478_382A, &[&bytes[..], &[0, 0xE0]].concat()).unwrap();
    let received = Receiver::new(NODE).accept(&recorded);
    assert_eq!(received, Ok(Some(Received::Slip(old))));
    let with_flags = |flags: u8| SlipMessage::decode_1(&[&bytes[..11], &[flags], &bytes[12..]].concat());
    let quiet = with_flags(0b0001_0010).unwrap();
    assert_eq!((quiet.class, quiet.slip, quiet.may_begin, quiet.sensors), (2, false, false, 2));
    assert_eq!(
        with_flags(0b0001_1011).unwrap_err().to_string(),
        "slipsense.Slip: class_index is 3, at most 2 allowed"
    );
    let no_model = [&bytes[..11], &[32 | 8], &[0; 14], &[64], &[0; 35]].concat();
    let no_model = SlipMessage::decode_1(&no_model).unwrap();
    assert_eq!((no_model.slip, no_model.invalid), (true, INVALID_NO_MODEL));

    let mut scan = [0; TAXELS];
    // Row 0 begins at column 5, the last row ends at column 26.
    (scan[5], scan[6], scan[31 * 32 + 26]) = (0xABC, 0x123, 0xFED);
    let piezo = PiezoFrame::from_counts(scan).unwrap();
    let parts = (1, 2, 1, 0, Some(piezo), Some(vec![[1, -2, 0x0403]]), 0x0807_0605);
    let mut buffer = RawBuffer::new();
    let bytes = frame(&parts).encode(&mut buffer);
    assert_eq!(bytes[..13], [1, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 1, 0]);
    assert_eq!(bytes[13..16], [0xBC, 0x3A, 0x12]);
    assert!(bytes[16..1_424].iter().all(|&byte| byte == 0));
    assert_eq!(bytes[1_424..], [0xD0, 0xFE, 5, 6, 7, 8, 0, 1, 1, 0, 0xFE, 0xFF, 3, 4]);
}

/// A hash of the network and of the calibrations' names, in sensor order: each bit of a name changes it.
#[test]
fn the_configuration_names_the_calibrations() {
    let configuration = |calibrations, sensors, network| {
        Origin { calibrations, ..Origin::default() }.message(sensors, network).configuration
    };
    assert_eq!(configuration([0x0001_0000, 0, 0], 1, 0xFFFF), 0xFFFE);
    assert_eq!(configuration([0x0001_0001, 0, 0], 1, 0), 0);
    assert_eq!(configuration([1, 1 << 9, 0], 2, 0), 0);
    assert_eq!(configuration([1, 1 << 9, 0], 1, 0), 1);
}

#[test]
fn short_messages_are_refused() {
    let bytes = SlipMessage::default().encode(NODE);
    assert_eq!(SLIP_BYTES, 63);
    let damaged = DecodeError::Damaged { message: "slipsense.Slip" };
    assert_eq!(SlipMessage::decode(NodeId::new(43).unwrap(), &bytes), Err(damaged));
    for length in 0..SLIP_BYTES {
        match SlipMessage::decode(NODE, &bytes[..length]) {
            Err(DecodeError::Truncated { message: "slipsense.Slip", found, .. }) if found == length => {}
            other => panic!("{length} bytes: {other:?}"),
        }
    }
    let parts = (0, 0, 0, 0, None, Some(vec![[1; 3]; 5]), 5);
    let mut buffer = RawBuffer::new();
    let bytes = frame(&parts).encode(&mut buffer);
    for length in 0..bytes.len() {
        match RawMessage::decode(&bytes[..length]) {
            Err(DecodeError::Truncated { message: "slipsense.Raw", expected, .. }) if expected > length => {}
            other => panic!("{length} bytes: {other:?}"),
        }
    }
    for (at, value, field) in [(11, 3, "sensor is 3, at most 2"), (1_431, 65, "xl is 65, at most 64")] {
        let mut changed = bytes.to_vec();
        changed[at] = value;
        let error = RawMessage::decode(&changed).unwrap_err();
        assert_eq!(error.to_string(), format!("slipsense.Raw: {field} allowed"));
    }
}

#[test]
fn a_dead_sensor_sends_no_raw_frames() {
    let mut transmitter = Transmitter::new(NodeId::DEFAULT);
    let mut buffer = RawBuffer::new();
    let dead = RawFrame { timestamp_us: 1, sequence: 2, sensor: 0, health: 3, input: SensorInput::default() };
    assert_eq!(transmitter.raw(&dead, &mut buffer).count(), 0);
    let half = RawFrame { input: SensorInput { xl: Some(&[]), ..dead.input }, ..dead };
    let first = transmitter.raw(&half, &mut buffer).next().expect("a part that delivered is sent");
    assert_eq!(first.data().last().map(|tail| tail & 31), Some(0), "no transfer identifier was skipped");
}
