//! Instructions of every kernel and of the whole path on an emulated Cortex-M7; `cargo xtask bench` starts it. No tasks
//! and no interrupts: what is counted is what was called.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod compression;
#[cfg(target_os = "none")]
mod kernels;
#[cfg(target_os = "none")]
mod measure;
#[cfg(target_os = "none")]
mod path;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on an emulated microcontroller; start it with `cargo xtask bench`.");
    std::process::exit(2);
}

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    use slipsense_qemu::emulated::semihosting::File;
    use slipsense_qemu::emulated::{exit, read_input};
    use slipsense_qemu::measured::{COMPRESSION_FILE, TRACE_FILE};

    let (mut frames, header, model) = read_input();
    let mut bench = measure::Bench::start();
    if File::open(COMPRESSION_FILE).is_some() {
        compression::measure(&mut bench, &mut frames, &header);
        exit(true);
    }
    let traced = File::open(TRACE_FILE).is_some();
    if !traced {
        kernels::measure(&mut bench, &model);
    }
    path::measure(&mut bench, &mut frames, &header, model, traced);
    exit(true)
}
