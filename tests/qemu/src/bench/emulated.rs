//! Start-up: read the networks, measure, end the emulator.

use core::ffi::CStr;
use core::fmt::Write;

use cortex_m_rt::{entry, exception};
use cortex_m_semihosting::debug;
use heapless::String;
use panic_semihosting as _;
use slipsense::net::{Aligned, Model};
use slipsense_qemu::input::{HEADER_BYTES, Header, MODEL_BYTES_MAX};
use slipsense_qemu::measured::Line;
use static_cell::ConstStaticCell;

use crate::counter::Counter;
use crate::semihosting::File;
use crate::{compression, kernels, path};

static SHIPPED: ConstStaticCell<Aligned<[u8; MODEL_BYTES_MAX]>> =
    ConstStaticCell::new(Aligned([0; MODEL_BYTES_MAX]));

/// The counter, and the file that its results go to.
pub struct Bench {
    pub counter: Counter,
    file: File,
}

impl Bench {
    /// Measure one call of a kernel.
    pub fn kernel(&mut self, name: &str, macs: usize, work: &mut dyn FnMut()) {
        let instructions = self.counter.of(work);
        self.put(Line::Kernel { macs: macs as u32, instructions, name });
    }

    /// Write one line.
    pub fn put(&mut self, line: Line<'_>) {
        let mut text = String::<256>::new();
        write!(text, "{line}").expect("a line is short");
        self.file.write_all(text.as_bytes()).expect("the host takes the output");
    }
}

#[entry]
fn main() -> ! {
    // The names of INPUT_FILE and MEASURED_FILE.
    let (mut frames, header, shipped) = model(c"frames.in", &mut SHIPPED.take().0);
    let file = File::create(c"measured.txt").expect("the emulator's working directory takes a file");
    let mut bench = Bench { counter: Counter::start(), file };
    let (expected, measured) = bench.counter.check();
    bench.put(Line::Check { expected, measured });
    // The name of COMPRESSION_FILE.
    if File::open(c"compress.in").is_some() {
        compression::measure(&mut bench, &mut frames, &header);
        end();
    }
    // The name of TRACE_FILE.
    let traced = File::open(c"trace.in").is_some();
    if !traced {
        kernels::measure(&mut bench, &shipped);
    }
    path::measure(&mut bench, &mut frames, &header, shipped, !traced);
    end()
}

fn end() -> ! {
    debug::exit(debug::EXIT_SUCCESS);
    // The emulator has ended.
    loop {
        cortex_m::asm::wfi();
    }
}

/// A file of the form of [`slipsense_qemu::input`], read up to its frames.
fn model(name: &CStr, buffer: &'static mut [u8]) -> (File, Header, Model<'static>) {
    let mut file = File::open(name).unwrap_or_else(|| panic!("cannot open {name:?}"));
    let mut header = [0; HEADER_BYTES];
    file.read_exact(&mut header).expect("the file has a header");
    let header = Header::decode(&header).expect("the file is one for this program");
    let (bytes, _) = buffer.split_at_mut(header.model_bytes as usize);
    file.read_exact(bytes).expect("the file holds a model");
    (file, header, Model::parse(bytes).expect("the model is valid"))
}

#[exception]
unsafe fn DefaultHandler(irq: i16) {
    panic!("interrupt {irq} was never enabled");
}
