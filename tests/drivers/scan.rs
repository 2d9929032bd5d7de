//! The scan: addresses as a port and multiplexers would see them, times, and whether two DMA streams are in step.

use slipsense::drivers::scan::{
    SETTLING_NS, SlotTiming, address_table, address_word, frames_between, is_in_step,
};
use slipsense::params::{TAXEL_COLS, TAXELS};

/// A GPIO port behind its bit set/reset register.
#[derive(Default)]
struct Port(u16);

impl Port {
    fn write(&mut self, word: u32) {
        self.0 = (self.0 & !((word >> 16) as u16)) | word as u16;
    }
}

#[test]
fn every_slot_converts_its_taxel_from_the_first_frame_on() {
    for first_pin in 0..=6 {
        let table = address_table(first_pin);
        let mut port = Port(0xffff);
        port.write(address_word(0, first_pin));
        for slot in 0..3 * TAXELS {
            let lines = port.0 >> first_pin & 0x3ff;
            let (col, row) = (lines & 31, lines >> 5);
            assert_eq!(usize::from(row) * TAXEL_COLS + usize::from(col), slot % TAXELS);
            // Other pins of the port keep their state.
            assert_eq!(port.0 | 0x3ff << first_pin, 0xffff);
            port.write(table[slot % TAXELS]);
        }
    }
}

#[test]
fn streams_are_in_step_in_every_slot_until_something_is_lost() {
    // As the hardware counts: down from the length, and anew.
    let left = |moved: u32, length: u32| length - moved % length;
    for arrays in 1..=3 {
        for lost @ (codes, words) in
            [(0, 0), (arrays, 0), (1, 0), (0, 1), (0, 2), (2 * arrays, 0), (100 * arrays, 0)]
        {
            for slot in 300..5_300 {
                let (words, codes) = (left(slot - words, 1024), left(slot * arrays - codes, 2048 * arrays));
                let in_step = is_in_step(words, codes, arrays);
                assert_eq!(in_step, lost == (0, 0), "{arrays} arrays, codes and words lost: {lost:?}");
            }
        }
    }
}

#[test]
fn the_boards_settle_in_time() {
    // Timer and ADC clocks of the board; a faster timer; the ADC's clock if it were not halved.
    for (name, timer_hz, adc_hz) in [
        ("H743", 240_000_000, 24_000_000),
        ("260 MHz", 260_000_000, 24_000_000),
        ("H743, 48 MHz", 240_000_000, 48_000_000),
    ] {
        let timing = SlotTiming::new(timer_hz, adc_hz);
        println!(
            "{name}: slot {} ticks, {} ns; ADC triggered after {} ticks, {} ns, of which {SETTLING_NS} ns are needed; \
             the last input sampled at {} ns; frame rate {:+} ppm",
            timing.slot_ticks,
            timing.slot_ns(),
            timing.trigger_ticks,
            timing.trigger_ns(),
            timing.sampled_ns(),
            timing.rate_error_ppm()
        );
        assert!(!timing.is_settling(0) && !timing.is_settling(timing.trigger_ticks));
        assert!(timing.is_settling(timing.trigger_ticks / 2));
        // 16 bits, three arrays: the last code comes up to 254 ns into the next slot, and DMA takes 200 ns.
        let read_ticks = (u64::from(timer_hz) * 440 / 1_000_000_000) as u32;
        assert!(!timing.is_settling(read_ticks) || adc_hz != 24_000_000);
        assert!(timing.trigger_ns() >= SETTLING_NS && timing.sampled_ns() < timing.slot_ns());
        let rate_hz = f64::from(timer_hz) / f64::from(timing.slot_ticks) / 1024.0;
        assert!((rate_hz / 240.0 - 1.0).abs() < 500e-6, "{rate_hz}");
        assert!((f64::from(timing.rate_error_ppm()) - (rate_hz / 240.0 - 1.0) * 1e6).abs() <= 1.0);
    }
}

#[test]
#[should_panic(expected = "before they have settled")]
fn a_slow_adc_is_refused() {
    SlotTiming::new(240_000_000, 16_000_000);
}

#[test]
#[should_panic(expected = "the frame rate is off")]
fn a_coarse_timer_is_refused() {
    SlotTiming::new(2_900_000, 24_000_000);
}

#[test]
fn frames_are_counted_by_time() {
    for (us, frames) in [(0, 1), (4_167, 1), (4_169, 1), (6_200, 1), (6_300, 2), (8_334, 2), (1_000_000, 240)]
    {
        assert_eq!(frames_between(us), frames, "{us} µs");
    }
}
