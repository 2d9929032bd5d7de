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
use embassy_stm32::rcc::mux::{Adcsel, Fdcansel, Saisel};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, LsConfig, Pll, PllDiv, PllMul, PllPreDiv, PllSource, Sysclk,
    VoltageScale,
};
use embassy_stm32::time::Hertz;

/// On the HSE pins: what the NUCLEO's ST-LINK puts on one, or the crystal between both (feature `crystal`).
pub const HSE_HZ: u32 = 8_000_000;
/// A clock from outside bypasses the oscillator that a crystal needs.
pub const IS_CRYSTAL: bool = cfg!(feature = "crystal");
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
