//! The Cortex-M7's kernels against the portable ones, on an emulated Cortex-M7. `cargo xtask test --only
//! qemu-kernels` starts it; what it prints is what was compared.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod emulated {
    use cortex_m_rt::entry;
    use cortex_m_semihosting::{debug, hprintln};
    use panic_semihosting as _;
    use slipsense_qemu::equal::{Compared, Kernels, ROUNDS, Scratch, compare};
    use static_cell::ConstStaticCell;

    static SCRATCH: ConstStaticCell<Scratch> = ConstStaticCell::new(Scratch::new());

    #[entry]
    fn main() -> ! {
        let mut differing = 0;
        compare(Kernels::HERE, ROUNDS, SCRATCH.take(), |compared| {
            let Compared { kernel, calls, differing: bad } = compared;
            hprintln!("{}: {} of {} calls differ from the portable kernel", kernel, bad, calls);
            differing += bad;
        });
        debug::exit(if differing == 0 { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
        // The emulator has ended.
        loop {
            cortex_m::asm::wfi();
        }
    }
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "This program runs on an emulated microcontroller; `cargo xtask test --only qemu-kernels` starts it."
    );
    std::process::exit(2);
}
