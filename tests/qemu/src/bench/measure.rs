//! The counter, and the file that its results go to.

use core::fmt::Write;

use heapless::String;
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::measured::{Line, MEASURED_FILE};

use crate::counter::Counter;

pub struct Bench {
    pub counter: Counter,
    file: File,
}

impl Bench {
    /// With a check of the counter as the first line.
    pub fn start() -> Self {
        let mut bench = Self { counter: Counter::start(), file: File::create(MEASURED_FILE) };
        let (expected, measured) = bench.counter.check();
        bench.put(Line::Check { expected, measured });
        bench
    }

    pub fn kernel(&mut self, name: &str, macs: usize, work: &mut dyn FnMut()) {
        let instructions = self.counter.of(work);
        self.put(Line::Kernel { macs: macs as u32, instructions, name });
    }

    pub fn put(&mut self, line: Line<'_>) {
        let mut text = String::<256>::new();
        write!(text, "{line}").expect("a line is short");
        self.file.write_all(text.as_bytes());
    }
}
