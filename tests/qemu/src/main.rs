//! Pipeline and wire on an emulated Cortex-M7. Reads frames from a file of the host and writes the results to another;
//! `cargo xtask qemu` starts it and compares.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[cortex_m_rt::entry]
fn main() -> ! {
    use slipsense_qemu::OUTPUT_FILE;
    use slipsense_qemu::emulated::counter::Counter;
    use slipsense_qemu::emulated::semihosting::File;
    use slipsense_qemu::emulated::{each_frame, exit, read_input};
    use slipsense_qemu::record::{RECORD_BYTES_MAX, SignalPath};

    let (mut frames, header, model) = read_input();
    let mut path = SignalPath::new(&header, model).expect("the header was checked");
    let counter = Counter::start();
    let mut output = File::create(OUTPUT_FILE);
    let mut encoded = heapless::Vec::<u8, RECORD_BYTES_MAX>::new();
    each_frame(&mut frames, &header, |_, stamp, parts| {
        let record = path.record(stamp, parts, |step| counter.of(step));
        encoded.clear();
        record.encode(|bytes| encoded.extend_from_slice(bytes).expect("room for a record"));
        output.write_all(&encoded);
    });
    exit(true)
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This program runs on an emulated microcontroller; start it with `cargo xtask qemu`.");
    std::process::exit(2);
}
