//! NUCLEO-H743ZI2 (STM32H743ZI, silicon revision V): clocks, pins, memory map, entry. What it does is in
//! `src/board/stm32`; what is behind the pins, in `docs/src/board/wiring.md`. It has not run on hardware.

pub mod clocks;

use cortex_m_rt::entry;
use defmt::unwrap;
use slipsense::node::Version;
use slipsense::update::partitions::{NUCLEO_H743ZI2, Partitions};

use crate::stm32::{self, Hardware, memory};

/// 256 KB of D2 SRAM, as a power of two.
pub const SRAM_D2_BITS: u32 = 18;

/// What lies where in flash.
pub const PARTITIONS: &Partitions = &NUCLEO_H743ZI2;
/// What GetInfo tells; the major number is the board's.
pub const HARDWARE: Version = Version { major: 1, minor: 0 };

#[entry]
fn main() -> ! {
    let mut core = unwrap!(cortex_m::Peripherals::take());
    memory::init(&mut core);
    let chip = embassy_stm32::init(clocks::config());
    stm32::run(stm32::nucleo_144!(chip, "NUCLEO-H743ZI2"))
}
