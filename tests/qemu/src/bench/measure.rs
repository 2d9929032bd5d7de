//! The counter, and the file that its results go to.

use core::fmt::{self, Write};

use heapless::String;
use slipsense_qemu::emulated::counter::Counter;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::measured::MEASURED_FILE;

pub struct Bench {
    pub counter: Counter,
    file: File,
}

impl Bench {
    /// With a check of the counter as the first line.
    pub fn start() -> Self {
        let mut bench = Self { counter: Counter::start(), file: File::create(MEASURED_FILE) };
        let (expected, measured) = bench.counter.check();
        bench.put(format_args!("check {expected} {measured}\n"));
        bench
    }

    pub fn kernel(&mut self, name: &str, macs: usize, work: &mut dyn FnMut()) {
        let instructions = self.counter.of(work);
        self.put(format_args!("kernel {macs} {instructions} {name}\n"));
    }

    pub fn put(&mut self, line: fmt::Arguments<'_>) {
        let mut text = String::<256>::new();
        text.write_fmt(line).expect("a line is short");
        self.file.write_all(text.as_bytes());
    }
}
