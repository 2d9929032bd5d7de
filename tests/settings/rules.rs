//! What may be set, and what is made of stored bytes; of any bytes, in `host-tools/recording`.

use proptest::prelude::*;
use slipsense::settings::{
    Damage, ELEMENTS_MAX, ENCODED_MAX, Kind, Setting, SettingError, Settings, TABLE, check,
};

/// Any value that the table allows.
fn valid() -> impl Strategy<Value = (Setting, Vec<i64>)> {
    (0..TABLE.len(), proptest::collection::vec(any::<u64>(), ELEMENTS_MAX)).prop_map(|(index, random)| {
        let definition = &TABLE[index];
        let any_of = |element: usize| {
            let (min, max) = definition.rule(element).bounds();
            min + (random[element] % (max - min + 1) as u64) as i64
        };
        let mut elements: Vec<i64> = (0..definition.default.len()).map(any_of).collect();
        if check(definition.setting, &elements).is_err() {
            elements = definition.default.to_vec();
        }
        (definition.setting, elements)
    })
}

proptest! {
    #[test]
    fn what_is_set_comes_back_from_bytes(values in proptest::collection::vec(valid(), 0..20)) {
        let mut settings = Settings::new();
        for (setting, elements) in values {
            settings.set(setting, &elements).unwrap();
            prop_assert_eq!(settings.get(setting), &elements);
        }
        prop_assert_eq!(Settings::decode(&settings.encode()), (settings, Damage::default()));
    }

    #[test]
    fn a_refused_value_changes_nothing(index in 0..TABLE.len(), elements in proptest::collection::vec(any::<i64>(), 0..40)) {
        let setting = TABLE[index].setting;
        let mut settings = Settings::new();
        match settings.set(setting, &elements) {
            Ok(_) => prop_assert_eq!(settings.get(setting), &elements),
            Err(_) => prop_assert_eq!(settings, Settings::new()),
        }
    }
}

#[test]
fn the_table_is_sound() {
    for (number, definition) in TABLE.iter().enumerate() {
        let name = definition.name;
        assert_eq!(definition.setting as usize, number, "{name}");
        assert_eq!(Setting::from_name(name.as_bytes()), Some(definition.setting));
        assert_eq!(check(definition.setting, definition.default), Ok(()), "{name}");
        assert!(!definition.help.is_empty() && name.len() < 50 && name.contains('.'), "{name}");
        assert!(name.bytes().all(|byte| b"abcdefghijklmnopqrstuvwxyz0123456789._".contains(&byte)), "{name}");
        // Every number that the rules allow fits the kind.
        let bits = 8 * definition.kind.bytes() as u32;
        for element in 0..definition.default.len() {
            let (min, max) = definition.rule(element).bounds();
            match definition.kind {
                Kind::Integer32 => assert!(min >= i64::from(i32::MIN) && max <= i64::from(i32::MAX)),
                Kind::Bit => assert_eq!((min, max), (0, 1)),
                _ => assert!(min >= 0 && max < 1 << bits, "{name}"),
            }
        }
    }
    assert_eq!(Settings::new().encode().len(), ENCODED_MAX);
}

#[test]
fn refusals_name_register_element_and_rule() {
    for (setting, elements, refusal) in [
        (Setting::Sensors, &[7][..], "slipsense.sensors: element 0 is 7, allowed are 1 to 3"),
        (Setting::NodeId, &[128], "uavcan.node.id: element 0 is 128, allowed are 0 to 127 and 65535"),
        (
            Setting::BitRates,
            &[1_000_000, 4_000_000],
            "uavcan.can.bitrate: element 1 is 4000000, allowed are 5000000 and 8000000",
        ),
        (Setting::Sensors, &[], "slipsense.sensors: 0 elements, need 1"),
        (
            Setting::OperatingPoint,
            &[0, 5, 4],
            "slipsense.slip.point: need element 1 (k) at most element 2 (n)",
        ),
        (Setting::SensorOrder, &[0, 1, 1], "slipsense.sensor.order: need each connector once"),
    ] {
        assert_eq!(Settings::new().set(setting, elements).unwrap_err().to_string(), refusal);
    }
    assert!(matches!(check(Setting::Sensors, &[0]), Err(SettingError::Element { .. })));
}

#[test]
fn stored_bytes_of_other_versions_are_read_as_far_as_they_go() {
    let settings =
        crate::settings(&[(Setting::NodeId, &[9]), (Setting::PlugAndPlay, &[0]), (Setting::Lock, &[1])]);
    let bytes = settings.encode().to_vec();
    // A later firmware's setting.
    let mut later = bytes.clone();
    later.extend([200, 2, 1, 7, 7]);
    let (found, damage) = Settings::decode(&later);
    assert_eq!((found, damage), (settings.clone(), Damage { unknown: 1, ..Damage::default() }));
    // An earlier one's, which could not expect a model: a number, a kind, a length and 8 bytes less.
    let (found, damage) = Settings::decode(&bytes[..bytes.len() - 11]);
    assert_eq!(damage, Damage { settings: 1 << Setting::ExpectedModel as u8, ..Damage::default() });
    assert_eq!(found.expected_model(), None);
    let found =
        (found.node_id().map(|id| id.get()), found.is_on(Setting::PlugAndPlay), found.is_on(Setting::Lock));
    assert_eq!(found, (Some(9), false, true));
    // A number that is not valid any more: the sensors.
    let at = bytes.windows(4).position(|window| window == [2, 1, 1, 1]).unwrap();
    let mut invalid = bytes.clone();
    invalid[at + 3] = 9;
    let (found, damage) = Settings::decode(&invalid);
    assert_eq!((found.sensors(), damage.settings), (1, 1 << Setting::Sensors as u8));
    assert_eq!(Settings::decode(&[]).1.settings, (1 << TABLE.len()) - 1);
}
