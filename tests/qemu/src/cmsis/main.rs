//! The FFT of CMSIS-DSP on an emulated Cortex-M7, and its port on this computer: the same program, which has to
//! print the same. `cargo xtask test --only qemu-cmsis` starts both.
#![cfg_attr(target_os = "none", no_std, no_main)]

use slipsense_qemu::spectra::Spectra;

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    cortex_m_semihosting::hprintln!("{}", Spectra::compare());
    slipsense_qemu::emulated::exit(true)
}

#[cfg(not(target_os = "none"))]
fn main() {
    println!("{}", Spectra::compare());
}
