//! Step zero: is there a clock on PH0, and how fast is it? Before the clock tree is set up, which waits for it for ever.

use cortex_m::peripheral::DWT;
use embassy_stm32::pac;

use super::clocks::{HSE_HZ, HSI_HZ, IS_CRYSTAL};

/// Until a clock that is there is ready: 10 ms.
const READY_CYCLES: u32 = HSI_HZ / 100;
/// 20 ms: one bit time of 1 µs is 50 ppm, and the counter of 16 bits does not wrap.
const COUNT_CYCLES: u32 = HSI_HZ / 50;
/// Clocks of PH0 in a bit time: the smallest numbers of quanta that FDCAN_NBTP takes well, 1 + 5 + 2.
const BIT_CLOCKS: u64 = 8;

fn wait(cycles: u32, until: impl Fn() -> bool) -> bool {
    let from = DWT::cycle_count();
    while DWT::cycle_count().wrapping_sub(from) < cycles {
        if until() {
            return true;
        }
    }
    until()
}

/// Hz by the HSI, which is within 0.5 % at 30 °C; 0 without a clock. The core must run on the HSI as after a reset,
/// and does so afterwards; HSE and FDCAN are as after a reset again.
///
/// FDCAN1 counts bit times of the HSE, its kernel clock after a reset, while it listens to itself; the core counts
/// its cycles.
pub fn measure_hse(core: &mut cortex_m::Peripherals) -> u32 {
    core.DCB.enable_trace();
    // Closed after power-on on this core: the counter would not start.
    DWT::unlock();
    core.DWT.enable_cycle_counter();
    let (rcc, can) = (pac::RCC, pac::FDCAN1);
    rcc.cr().modify(|w| w.set_hsebyp(!IS_CRYSTAL));
    rcc.cr().modify(|w| w.set_hseon(true));
    let mut bits = 0;
    if wait(READY_CYCLES, || rcc.cr().read().hserdy()) {
        rcc.apb1henr().modify(|w| w.set_fdcanen(true));
        // The clock is on two cycles after the write; this read takes more.
        let _ = rcc.apb1henr().read();
        can.cccr().modify(|w| w.set_init(true));
        can.cccr().modify(|w| w.set_cce(true));
        // Silent: inside loop back, TX recessive.
        can.cccr().modify(|w| {
            w.set_test(true);
            w.set_mon(true);
        });
        can.test().modify(|w| w.set_lbck(true));
        can.nbtp().write(|w| {
            w.set_nbrp(0);
            w.set_ntseg1(4);
            w.set_ntseg2(1);
            w.set_nsjw(1);
        });
        can.tscc().write(|w| w.set_tss(1));
        can.cccr().modify(|w| w.set_init(false));
        // Without a clock it never leaves its initialization.
        if wait(READY_CYCLES, || !can.cccr().read().init()) {
            let from = can.tscv().read().tsc();
            wait(COUNT_CYCLES, || false);
            bits = can.tscv().read().tsc().wrapping_sub(from);
        }
        can.cccr().modify(|w| w.set_init(true));
        rcc.apb1hrstr().modify(|w| w.set_fdcanrst(true));
        rcc.apb1hrstr().modify(|w| w.set_fdcanrst(false));
        rcc.apb1henr().modify(|w| w.set_fdcanen(false));
    }
    rcc.cr().modify(|w| w.set_hseon(false));
    wait(READY_CYCLES, || !rcc.cr().read().hserdy());
    rcc.cr().modify(|w| w.set_hsebyp(false));
    (u64::from(bits) * BIT_CLOCKS * u64::from(HSI_HZ) / u64::from(COUNT_CYCLES)) as u32
}

/// Measurements until a clock is taken for missing: 0.3 s. A crystal takes 2 ms (DS12110, HSE oscillator), the ST-LINK as
/// long as its own start.
const TRIES: u32 = 30;
/// What a measurement may be off: the HSI's 2 % in the cold, and as much again. No wrong crystal is as near.
const TOLERANCE_PERCENT: u32 = 4;

/// Wait for the external clock, not for ever, and measure it. `Err`: the frequency found, Hz; 0 where none came. The
/// core counts its cycles from then on.
///
/// For a chip that runs on its HSI, as after reset: a wrong frequency would keep the PLLs from locking, for which
/// embassy-stm32 0.6 waits for ever, as it does for a clock that does not come.
#[inline(never)]
pub fn check_hse(core: &mut cortex_m::Peripherals) -> Result<u32, u32> {
    let found_hz = (0..TRIES).map(|_| measure_hse(core)).find(|&hz| hz != 0).unwrap_or(0);
    if is_near(found_hz) { Ok(found_hz) } else { Err(found_hz) }
}

/// Is this frequency near enough for the PLLs to lock?
pub fn is_near(hz: u32) -> bool {
    hz.abs_diff(HSE_HZ) <= HSE_HZ / 100 * TOLERANCE_PERCENT
}
