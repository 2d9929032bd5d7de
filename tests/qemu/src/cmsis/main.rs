//! The FFT of CMSIS-DSP on an emulated Cortex-M7, and its port on this computer: the same program, which has to
//! print the same. `cargo xtask test --only qemu-cmsis` starts both.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod emulated {
    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};
    use panic_semihosting as _;
    use slipsense_qemu::spectra::Spectra;

    #[entry]
    fn main() -> ! {
        hprintln!("{}", Spectra::compare());
        debug::exit(debug::EXIT_SUCCESS);
        // The emulator has ended.
        loop {
            cortex_m::asm::wfi();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    println!("{}", slipsense_qemu::spectra::Spectra::compare());
}
