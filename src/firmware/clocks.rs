//! The clock tree: 8 MHz from the ST-LINK or a crystal → PLLs → 480 MHz core, 240 MHz buses, 80 MHz FDCAN kernel.
//!
//! ```text
//! HSE 8 MHz ─/2─ 4 MHz ─┬─ PLL1 ×240 = 960 MHz ── P/2  480 MHz  core; /2 = 240 MHz AHB; /2 = 120 MHz APB
//!                       │                      └─ Q/12  80 MHz  FDCAN
//!                       ├─ PLL2 ×160 = 640 MHz ── P/10  64 MHz  SPI kernel, 8 MHz on the wire
//!                       └─ PLL3 ×120 = 480 MHz ── R/10  48 MHz  ADC kernel; the converter halves it
//! ```
//!
//! Two choices that look arbitrary and are not:
//! - The reference is 4 MHz. The wide-range VCO takes more than 2 and up to 16 MHz (DS12110, PLL
//!   characteristics); a reference of exactly 2 MHz is the medium VCO's.
//! - No VCO runs between 150 and 420 MHz. There embassy-stm32 0.6 selects the medium VCO whatever the
//!   reference, and that one takes 1 to 2 MHz only.
//!
//! All three PLLs are set up at once: for a PLL that is left out, embassy-stm32 0.6 overwrites all of PLLCKSELR, the
//! dividers and source of the PLLs already running included; the silicon is documented to ignore that, and this tree
//! does not lean on it.
//!
//! 480 MHz needs silicon revision V or X and voltage scale 0, which embassy reaches through scale 1 and
//! the overdrive bit.

use embassy_stm32::Config;
use embassy_stm32::pac;
use embassy_stm32::pac::rcc::vals::Usart234578sel;
use embassy_stm32::rcc::mux::{Adcsel, Fdcansel, Saisel};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, LsConfig, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk,
    VoltageScale,
};
use embassy_stm32::time::Hertz;

/// On the HSE pins: what the NUCLEO's ST-LINK puts on one, or the crystal between both (feature `crystal`).
pub const HSE_HZ: u32 = 8_000_000;
/// A clock from outside bypasses the oscillator that a crystal needs.
const IS_CRYSTAL: bool = cfg!(feature = "crystal");
/// The oscillator that the chip starts with, ±1 % (DS12110, HSI oscillator).
pub const HSI_HZ: u32 = 64_000_000;
/// Clock of the FDCAN bit time quanta.
pub const FDCAN_KERNEL_HZ: u32 = HSE_HZ / 2 * 240 / 12;
/// Clock of the timers on APB2: twice that bus.
pub const TIMER_HZ: u32 = HSE_HZ / 2 * 240 / 2 / 2;
/// Clock of the converter itself: on revision V half the kernel clock (RM0433, ADC clocks).
pub const ADC_HZ: u32 = HSE_HZ / 2 * 120 / 10 / 2;

/// The tree above, as embassy wants it.
pub fn config() -> Config {
    let pll = |mul, divp, divq, divr| Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV2,
        mul,
        fracn: None,
        divp,
        divq,
        divr,
    };
    let mode = if IS_CRYSTAL { HseMode::Oscillator } else { HseMode::Bypass };
    let mut config = Config::default();
    let rcc = &mut config.rcc;
    rcc.hsi = None;
    rcc.hse = Some(Hse { freq: Hertz(HSE_HZ), mode });
    // The I/O compensation cell runs from it; edges of fast pins are out of specification without.
    rcc.csi = true;
    // No real-time clock. The watchdog switches the LSI on by itself.
    rcc.ls = LsConfig::off();
    rcc.pll1 = Some(pll(PllMul::MUL240, Some(PllDiv::DIV2), Some(PllDiv::DIV12), None));
    rcc.pll2 = Some(pll(PllMul::MUL160, Some(PllDiv::DIV10), None, None));
    rcc.pll3 = Some(pll(PllMul::MUL120, None, None, Some(PllDiv::DIV10)));
    rcc.sys = Sysclk::PLL1_P;
    rcc.voltage_scale = VoltageScale::Scale0;
    rcc.ahb_pre = AHBPrescaler::DIV2;
    rcc.apb1_pre = APBPrescaler::DIV2;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc.apb3_pre = APBPrescaler::DIV2;
    rcc.apb4_pre = APBPrescaler::DIV2;
    rcc.mux.fdcansel = Fdcansel::PLL1_Q;
    rcc.mux.adcsel = Adcsel::PLL3_R;
    rcc.mux.spi123sel = Saisel::PLL2_P;
    config
}

/// How long the clock may take to come, in tries of some 20 cycles of the HSI: 300 ms. A crystal takes 2 ms (DS12110,
/// HSE oscillator), the ST-LINK as long as its own start.
const HSE_TRIES: u32 = 1_000_000;
/// What the measurement may be off: the HSI's 1 %, the polling's 1 %, and as much again. No wrong crystal is as near.
const TOLERANCE_PERCENT: u32 = 4;
/// Bit rate of the ruler: a byte of ten bits takes 1 ms.
const RULER_BAUD: u32 = 10_000;
/// Tries of some cycles of 4 to 48 MHz for a byte of the ruler, and the idle one before the first: more than ten times
/// their length.
const RULER_TRIES: u32 = 400_000;

/// Wait for the external clock, not for ever, and measure it. `Err`: the frequency found, Hz; 0 where none came.
///
/// For a chip that runs on its HSI, as after reset: a wrong frequency would keep the PLLs from locking, for which
/// embassy-stm32 0.6 waits for ever, as it does for a clock that does not come.
pub fn start_hse() -> Result<u32, u32> {
    let rcc = pac::RCC;
    rcc.cr().modify(|w| w.set_hsebyp(!IS_CRYSTAL));
    rcc.cr().modify(|w| w.set_hseon(true));
    if !(0..HSE_TRIES).any(|_| rcc.cr().read().hserdy()) {
        return Err(0);
    }
    let found_hz = measure_hse_hz();
    let off_hz = found_hz.abs_diff(HSE_HZ);
    if off_hz <= HSE_HZ / 100 * TOLERANCE_PERCENT { Ok(found_hz) } else { Err(found_hz) }
}

/// The external clock, Hz, by the HSI: good to about 2 %. 0 if it cannot be measured.
///
/// For a chip as in [`start_hse`], with that clock ready. For some milliseconds the core runs on it, and TIM7 counts its
/// cycles during a byte that USART3, on no pin, sends by the HSI.
pub fn measure_hse_hz() -> u32 {
    let (rcc, timer, ruler) = (pac::RCC, pac::TIM7, pac::USART3);
    rcc.apb1lenr().modify(|w| {
        w.set_tim7en(true);
        w.set_usart3en(true);
    });
    rcc.d2ccip2r().modify(|w| w.set_usart234578sel(Usart234578sel::HSI));
    cortex_m::asm::dsb();
    ruler.brr().write(|w| w.set_brr((HSI_HZ / RULER_BAUD) as u16));
    ruler.cr1().write(|w| {
        w.set_ue(true);
        w.set_te(true);
    });
    timer.arr().write(|w| w.set_arr(u16::MAX));
    timer.cr1().write(|w| w.set_cen(true));
    let on = |clock| {
        rcc.cfgr().modify(|w| w.set_sw(clock));
        (0..RULER_TRIES).any(|_| rcc.cfgr().read().sws() == clock)
    };
    // Two bytes fill the transmitter; from then on each place in it comes free a byte after the last.
    let mut stamps = [0; 4];
    let mut sent = on(Sysclk::HSE);
    for stamp in &mut stamps {
        ruler.tdr().write(|w| w.set_dr(0));
        sent &= (0..RULER_TRIES).any(|_| ruler.isr().read().txe());
        *stamp = timer.cnt().read().cnt();
    }
    sent &= on(Sysclk::HSI);
    ruler.cr1().write(|_| {});
    timer.cr1().write(|_| {});
    rcc.apb1lenr().modify(|w| {
        w.set_tim7en(false);
        w.set_usart3en(false);
    });
    let [.., before, after] = stamps;
    if sent { u32::from(after.wrapping_sub(before)) * (RULER_BAUD / 10) } else { 0 }
}
