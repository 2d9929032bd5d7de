//! The page for the first hour says what the firmware does: its `ip link` commands give the bit rates and sample points
//! of `can.rs`.

use std::collections::BTreeMap;

use super::wiring::repository_file;

const PAGE: &str = "docs/src/board/first-slip.md";
const CODE: &str = "src/firmware/bin/app/can.rs";
/// Clock of the FDCAN's time quanta (`clocks.rs`).
const KERNEL_HZ: u32 = 80_000_000;

/// Bit rate and sample point, thousandths of a bit.
type Timing = (u32, u32);

fn timing(clock_hz: u32, seg1: u32, seg2: u32) -> Timing {
    let quanta = 1 + seg1 + seg2;
    assert!(clock_hz.is_multiple_of(quanta), "{clock_hz} Hz in {quanta} quanta");
    (clock_hz / quanta, (1 + seg1) * 1000 / quanta)
}

/// `NAME: BitTiming = BitTiming { seg1: 63, seg2: 16, sync_jump_width: 16 }` of the firmware.
fn of_firmware(name: &str) -> Timing {
    let code = repository_file(CODE);
    let begin = format!("const {name}: BitTiming = BitTiming {{ ");
    let (_, rest) = code.split_once(&begin).unwrap_or_else(|| panic!("{CODE}: {name}"));
    let (fields, _) = rest.split_once('}').expect("an end");
    let number = |field: &str| -> u32 {
        let (_, rest) = fields.split_once(&format!("{field}: ")).expect("a field");
        rest.split([',', ' ']).next().and_then(|text| text.parse().ok()).expect("a number")
    };
    timing(KERNEL_HZ, number("seg1"), number("seg2"))
}

#[test]
fn its_bit_timings_are_those_of_the_firmware() {
    let page = repository_file(PAGE);
    let nominal = of_firmware("NOMINAL");
    assert_eq!(nominal.0, 1_000_000);
    let data = [("8 Mbit/s", of_firmware("DATA_8M")), ("5 Mbit/s", of_firmware("DATA_5M"))];
    assert_eq!(data.map(|(_, (rate, _))| rate), [8_000_000, 5_000_000]);
    let mut compared = 0;
    for row in page.lines().filter(|line| line.contains("ip link set can0 up type can tq")) {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let [_, clock, rate, command, _] = cells[..] else { panic!("{row}") };
        let clock_mhz: u32 = clock.strip_suffix(" MHz").and_then(|text| text.parse().ok()).expect("a clock");
        let words: Vec<&str> = command.trim_matches('`').split(' ').collect();
        let values: BTreeMap<&str, u32> =
            words.windows(2).filter_map(|pair| Some((pair[0], pair[1].parse().ok()?))).collect();
        for prefix in ["", "d"] {
            let value = |name: &str| values[format!("{prefix}{name}").as_str()];
            // The kernel makes whole clocks of it, rounded.
            assert_eq!((value("tq") * clock_mhz + 500) / 1000, 1, "{row}");
            let found =
                timing(clock_mhz * 1_000_000, value("prop-seg") + value("phase-seg1"), value("phase-seg2"));
            let expected = match prefix {
                "" => nominal,
                _ => data.into_iter().find(|(name, _)| *name == rate).expect("a rate of the firmware").1,
            };
            assert_eq!(found, expected, "{row}");
            assert!(value("sjw") <= value("phase-seg2"), "{row}");
        }
        compared += 1;
    }
    assert_eq!(compared, 4);
}
