//! Firmware. Each board has a folder under `src/board/` with its clocks, memory, drivers and entry
//! point; this file picks one. Everything that the host runs too is in the library.
#![cfg_attr(target_os = "none", no_std, no_main)]

// In the binary, not in the library: the library denies unsafe code outside `simd`, registers need it.
#[cfg(target_os = "none")]
#[path = "board/h743/mod.rs"]
mod h743;

#[cfg(not(target_os = "none"))]
fn main() -> std::process::ExitCode {
    eprintln!("slipsense-firmware runs on a NUCLEO-H743ZI2: cargo build-h743; cargo flash-h743");
    std::process::ExitCode::from(2)
}
