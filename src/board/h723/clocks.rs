//! The clock tree: 8 MHz from the ST-LINK → PLLs → 520 MHz core, 260 MHz buses, 80 MHz FDCAN kernel.
//!
//! ```text
//! HSE 8 MHz ─/2─ 4 MHz ─┬─ PLL1 ×130 = 520 MHz ── P/1  520 MHz  core; /2 = 260 MHz AHB, timers; /2 = 130 MHz APB
//!                       ├─ PLL2 ×160 = 640 MHz ─┬─ P/10  64 MHz  SPI kernel, 8 MHz on the wire
//!                       │                       └─ Q/8   80 MHz  FDCAN
//!                       └─ PLL3 ×120 = 480 MHz ── R/10  48 MHz  ADC kernel; the converter halves it
//! ```
//!
//! 550 MHz needs an option byte (CPUFREQ_BOOST), and takes the error correction of the tightly coupled memories.
//! Why the reference is 4 MHz and no VCO runs below 420 MHz, the H743's `clocks.rs` says.

use embassy_stm32::Config;
use embassy_stm32::rcc::mux::{Adcsel, Fdcansel, Saisel};
use embassy_stm32::rcc::{
    AHBPrescaler, APBPrescaler, Hse, HseMode, LsConfig, Pll, PllDiv, PllMul, PllPreDiv, PllSource,
    SupplyConfig, Sysclk, VoltageScale,
};
use embassy_stm32::time::Hertz;

/// What the NUCLEO's ST-LINK puts on the HSE pin. A board with a crystal changes this and the mode.
const HSE_HZ: u32 = 8_000_000;
/// Clock of the FDCAN bit time quanta.
pub const FDCAN_KERNEL_HZ: u32 = HSE_HZ / 2 * 160 / 8;
/// Clock of the timers on APB2: twice that bus.
pub const TIMER_HZ: u32 = HSE_HZ / 2 * 130 / 2;
/// Clock of the converter itself, if it halves its kernel clock as the H743's does; it may run at twice that.
pub const ADC_HZ: u32 = HSE_HZ / 2 * 120 / 10 / 2;

/// The tree above, as embassy wants it.
pub fn config() -> Config {
    let pll = |mul, divp, divq, divr| Pll {
        source: PllSource::HSE,
        prediv: PllPreDiv::DIV2,
        mul,
        divp,
        divq,
        divr,
    };
    let mut config = Config::default();
    let rcc = &mut config.rcc;
    rcc.hsi = None;
    rcc.hse = Some(Hse { freq: Hertz(HSE_HZ), mode: HseMode::Bypass });
    // The I/O compensation cell runs from it; edges of fast pins are out of specification without.
    rcc.csi = true;
    // No real-time clock. The watchdog switches the LSI on by itself.
    rcc.ls = LsConfig::off();
    rcc.pll1 = Some(pll(PllMul::MUL130, Some(PllDiv::DIV1), None, None));
    rcc.pll2 = Some(pll(PllMul::MUL160, Some(PllDiv::DIV10), Some(PllDiv::DIV8), None));
    rcc.pll3 = Some(pll(PllMul::MUL120, None, None, Some(PllDiv::DIV10)));
    rcc.sys = Sysclk::PLL1_P;
    rcc.voltage_scale = VoltageScale::Scale0;
    rcc.supply_config = SupplyConfig::LDO;
    rcc.ahb_pre = AHBPrescaler::DIV2;
    rcc.apb1_pre = APBPrescaler::DIV2;
    rcc.apb2_pre = APBPrescaler::DIV2;
    rcc.apb3_pre = APBPrescaler::DIV2;
    rcc.apb4_pre = APBPrescaler::DIV2;
    rcc.mux.fdcansel = Fdcansel::PLL2_Q;
    rcc.mux.adcsel = Adcsel::PLL3_R;
    rcc.mux.spi123sel = Saisel::PLL2_P;
    config
}
