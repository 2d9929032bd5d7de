//! The wiring page says what the firmware does: every pin in use is in its table, and its times are those of the code.

use std::fs;
use std::path::Path;

use slipsense::drivers::scan::{SETTLING_NS, SlotTiming};

pub fn repository_file(path: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(path);
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn thousands(n: u32) -> String {
    if n < 1_000 { n.to_string() } else { format!("{},{:03}", n / 1_000, n % 1_000) }
}

#[test]
fn every_pin_of_the_firmware_is_in_the_table_once() {
    let page = repository_file("docs/src/board/wiring.md");
    let code = repository_file("src/firmware/bin/app/pins.rs");
    let is_pin = |name: &&str| {
        let letters = name.as_bytes();
        matches!(letters, [b'P', b'A'..=b'K', digits @ ..] if !digits.is_empty() && digits.iter().all(u8::is_ascii_digit))
    };
    let words =
        code.split("chip.").skip(1).filter_map(|rest| rest.split(|c: char| !c.is_alphanumeric()).next());
    let pins: Vec<&str> = words.filter(is_pin).collect();
    assert_eq!(pins.len(), 22, "{pins:?}");
    for pin in pins {
        let rows = page.lines().filter(|line| line.starts_with(&format!("| {pin} |"))).count();
        assert_eq!(rows, 1, "{pin}");
    }
}

#[test]
fn its_times_are_those_of_the_code() {
    let page = repository_file("docs/src/board/wiring.md");
    assert!(page.contains(&format!("| **together** | **{}** |", thousands(SETTLING_NS))), "{SETTLING_NS}");
    let timing = SlotTiming::new(240_000_000, 24_000_000);
    let ticks = |ticks: u32, ns: u32| format!("{} ticks, {} ns", thousands(ticks), thousands(ns));
    for (name, cell) in [
        ("slot", ticks(timing.slot_ticks, timing.slot_ns())),
        ("ADC triggered after", ticks(timing.trigger_ticks, timing.trigger_ns())),
        ("third array sampled after", format!("{} ns", thousands(timing.sampled_ns()))),
        ("frame rate against 240 Hz", format!("{} ppm", timing.rate_error_ppm()).replace('-', "−")),
    ] {
        let row = format!("| {name} | {cell} |");
        assert!(page.contains(&row), "{row}");
    }
}
