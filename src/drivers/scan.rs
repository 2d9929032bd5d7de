//! The scan of up to three arrays: which taxel when, what drives the multiplexers, and whether it settles in time.
//!
//! All arrays share ten address lines, so that one slot reads the same taxel of each: the timer ends a slot, DMA
//! writes the next address to the port, and after the settling time the timer starts the ADC, which converts the
//! arrays one after the other. 1024 slots are a frame.
//!
//! ```text
//!  slot k        │ settling            │ array 0 │ array 1 │ array 2 │   slot k+1
//!  address       ╳ taxel k                                           ╳ taxel k+1
//!                ^ update: DMA word k-1 ^ trigger                 ^ last input sampled
//! ```

use crate::params::{FRAME_RATE_HZ, MAX_SENSORS, TAXEL_COLS, TAXEL_ROWS, TAXELS};

/// Address lines of the column multiplexer: the lowest.
pub const COLUMN_LINES: u32 = TAXEL_COLS.ilog2();
/// Address lines of the row driver, above those of the columns.
pub const ROW_LINES: u32 = TAXEL_ROWS.ilog2();
/// All of them, on neighbouring pins of one port.
pub const ADDRESS_LINES: u32 = COLUMN_LINES + ROW_LINES;

/// The word that puts the address of `taxel` (row-major) on the lines from `first_pin` on, and on no other, in a
/// GPIO port's bit set/reset register: lines to set in the low half, lines to clear in the high half.
pub const fn address_word(taxel: usize, first_pin: u32) -> u32 {
    const LINES: u32 = (1 << ADDRESS_LINES) - 1;
    let high = taxel as u32 & LINES;
    high << first_pin | (!high & LINES) << (first_pin + 16)
}

/// What DMA writes to the port, one word at the end of each slot, over and over: word k is the address of taxel k+1, whose
/// slot it begins. Before the first slot, taxel 0 must be addressed by [`address_word`].
pub const fn address_table(first_pin: u32) -> [u32; TAXELS] {
    let mut table = [0; TAXELS];
    let mut slot = 0;
    while slot < TAXELS {
        table[slot] = address_word((slot + 1) % TAXELS, first_pin);
        slot += 1;
    }
    table
}

/// From the timer's update to the new address on the pins: DMA at the highest priority on a busy bus. As the next, a
/// requirement on a board, from the simulation of the front end (`cargo xtask front-end`), not measured.
pub const DMA_NS: u32 = 200;
/// From the address on the pins until the reading is within half a count of 4096: the slowest transition between
/// any two taxels, one at full scale and one untouched, at the worst of its capacitances, rounded up.
pub const ANALOG_NS: u32 = 1_750;
/// From the timer's update until every input is within half a count, ns.
pub const SETTLING_NS: u32 = DMA_NS + ANALOG_NS;

/// ADC clock cycles, in halves (RM0433, ADC timing): trigger to start of sampling, at most.
const LATENCY_HALF_CYCLES: u64 = 2 * 4;
/// Sampling, 8.5 cycles: the setting that the board makes.
const SAMPLING_HALF_CYCLES: u64 = 17;
/// Conversion to 16 bits, 8.5 cycles.
const CONVERSION_HALF_CYCLES: u64 = 17;
/// Between the last sampling and the next address.
const GUARD_NS: u32 = 100;

/// Largest deviation from the frame rate that the whole number of timer ticks per slot may bring.
pub const RATE_ERROR_MAX_PPM: u32 = 500;

/// When things happen in a slot, for a timer and an ADC of given clocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlotTiming {
    timer_hz: u32,
    adc_hz: u32,
    /// Ticks of the timer from one address to the next.
    pub slot_ticks: u32,
    /// Ticks from an address to the trigger of the ADC.
    pub trigger_ticks: u32,
}

impl SlotTiming {
    /// The slot nearest to 1/(240 · 1024) s, and the latest trigger at which [`MAX_SENSORS`] inputs are sampled
    /// before it ends. `adc_hz`: the clock that the converter itself runs on, after all dividers.
    ///
    /// # Panics
    /// In a constant, so at compile time: where inputs would be sampled before they have settled, where conversions
    /// would run into the next trigger, where the frame rate is off by more than [`RATE_ERROR_MAX_PPM`].
    pub const fn new(timer_hz: u32, adc_hz: u32) -> Self {
        let slots_per_second = FRAME_RATE_HZ * TAXELS as u32;
        let slot_ticks = (timer_hz + slots_per_second / 2) / slots_per_second;
        let timing = Self { timer_hz, adc_hz, slot_ticks, trigger_ticks: 0 };
        let tail_ns = timing.adc_ns(timing.sampled_half_cycles()) + GUARD_NS;
        let tail_ticks = (tail_ns as u64 * timer_hz as u64).div_ceil(1_000_000_000) as u32;
        assert!(tail_ticks < slot_ticks, "the inputs cannot be sampled within a slot");
        let timing = Self { trigger_ticks: slot_ticks - tail_ticks, ..timing };
        assert!(timing.trigger_ns() >= SETTLING_NS, "the inputs are sampled before they have settled");
        assert!(
            timing.adc_ns(timing.sequence_half_cycles()) < timing.slot_ns(),
            "conversions outlast a slot"
        );
        assert!(timing.rate_error_ppm().unsigned_abs() <= RATE_ERROR_MAX_PPM, "the frame rate is off");
        timing
    }

    /// From one address to the next, ns, rounded down.
    pub const fn slot_ns(&self) -> u32 {
        (self.slot_ticks as u64 * 1_000_000_000 / self.timer_hz as u64) as u32
    }

    /// From an address to the trigger of the ADC, ns, rounded down.
    pub const fn trigger_ns(&self) -> u32 {
        (self.trigger_ticks as u64 * 1_000_000_000 / self.timer_hz as u64) as u32
    }

    /// Do the inputs settle at this count of the timer: are the address out and the code of the last conversion, which
    /// ends in the next slot, fetched, and is the ADC not triggered yet?
    pub const fn is_settling(&self, ticks: u32) -> bool {
        let converted_ns = self.trigger_ns() + self.adc_ns(self.sequence_half_cycles());
        let quiet_ns = converted_ns.saturating_sub(self.slot_ns()) + DMA_NS;
        let quiet_ticks = (quiet_ns as u64 * self.timer_hz as u64 / 1_000_000_000) as u32;
        ticks > quiet_ticks && ticks < self.trigger_ticks
    }

    /// From an address to the end of sampling of the last of [`MAX_SENSORS`] inputs, ns.
    pub const fn sampled_ns(&self) -> u32 {
        self.trigger_ns() + self.adc_ns(self.sampled_half_cycles())
    }

    /// How far the frame rate is from nominal, parts per million; positive is faster.
    pub const fn rate_error_ppm(&self) -> i32 {
        let nominal = FRAME_RATE_HZ as i64 * TAXELS as i64 * self.slot_ticks as i64;
        ((self.timer_hz as i64 - nominal) * 1_000_000 / nominal) as i32
    }

    /// Trigger to the end of sampling of the last input.
    const fn sampled_half_cycles(&self) -> u64 {
        self.sequence_half_cycles() - CONVERSION_HALF_CYCLES
    }

    /// Trigger to the end of the last conversion.
    const fn sequence_half_cycles(&self) -> u64 {
        LATENCY_HALF_CYCLES + MAX_SENSORS as u64 * (SAMPLING_HALF_CYCLES + CONVERSION_HALF_CYCLES)
    }

    const fn adc_ns(&self, half_cycles: u64) -> u32 {
        (half_cycles * 1_000_000_000).div_ceil(2 * self.adc_hz as u64) as u32
    }
}

/// Do the conversions belong to the addresses? By what both DMA streams have left (their NDTR registers), read while
/// the inputs settle: `words_left` of the [`address_table`], `codes_left` of a ring of two frames of `arrays` arrays.
///
/// While the inputs of slot k settle, k addresses are written and k slots converted, so a single trigger or address
/// that was lost shows. At any other time the two differ by one or not, and it would not.
pub const fn is_in_step(words_left: u32, codes_left: u32, arrays: u32) -> bool {
    const SLOTS: u32 = TAXELS as u32;
    let frame = if arrays == 0 { SLOTS } else { SLOTS * arrays };
    // Both count down and begin again; what is left of a frame is a whole number of slots.
    codes_left % frame == words_left % SLOTS * (frame / SLOTS)
}

/// How many frames ended between two frame ticks that are `elapsed_us` apart, at least 1.
pub const fn frames_between(elapsed_us: u64) -> u32 {
    let frames = (elapsed_us * FRAME_RATE_HZ as u64 + 500_000) / 1_000_000;
    if frames == 0 { 1 } else { frames as u32 }
}
