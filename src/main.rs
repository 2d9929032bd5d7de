//! Firmware. Clocks, memory map and entry point are in `src/board/h743`, the rest of the hardware in
//! `src/board/stm32`; everything that the host runs too is in the library.
#![cfg_attr(target_os = "none", no_std, no_main)]

// In the binary, not in the library: the library denies unsafe code outside `simd`, registers need it.
#[cfg(target_os = "none")]
#[path = "board/h743/mod.rs"]
mod board;
#[cfg(target_os = "none")]
#[path = "board/stm32/mod.rs"]
mod stm32;

#[cfg(all(feature = "adxl382", feature = "icm42688"))]
compile_error!(
    "all sensors of a board have the same accelerometer: adxl382, icm42688, or neither for the ADXL380"
);

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("slipsense-firmware runs on a NUCLEO-H743ZI2: cargo build-h743; cargo flash-h743");
    std::process::ExitCode::from(2)
}
