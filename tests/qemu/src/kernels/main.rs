//! The Cortex-M7's kernels against the portable ones, on an emulated Cortex-M7. `cargo xtask test --only
//! qemu-kernels` starts it; what it prints is what was compared.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    use slipsense_qemu::equality::{Compared, ROUNDS, Scratch, compare};

    static SCRATCH: static_cell::ConstStaticCell<Scratch> =
        static_cell::ConstStaticCell::new(Scratch::ZEROED);
    let mut differing = 0;
    compare(ROUNDS, SCRATCH.take(), |compared| {
        let Compared { kernel, calls, differing: here } = compared;
        // The macro takes no names in braces.
        cortex_m_semihosting::hprintln!(
            "{}: {} of {} calls differ from the portable kernel",
            kernel,
            here,
            calls
        );
        differing += here;
    });
    slipsense_qemu::emulated::exit(differing == 0)
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!(
        "This program runs on an emulated microcontroller; `cargo xtask test --only qemu-kernels` starts it."
    );
    std::process::exit(2);
}
