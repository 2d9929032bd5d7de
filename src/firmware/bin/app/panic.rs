//! A panic: its record goes into RAM that a reset does not clear, then the node restarts and says so.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use defmt::{Display2Format, error};
use slipsense::board::panic_record::{PANIC_WORDS, PanicRecord};

/// In DTCM, which is not cached: what is written is there after the reset.
#[unsafe(link_section = ".uninit.panic_record")]
static mut RECORD: MaybeUninit<[u32; PANIC_WORDS]> = MaybeUninit::uninit();

/// In [`FRESH`]: the record is why the chip starts.
const IS_FRESH: u32 = u32::from_le_bytes(*b"new!");
/// Tells the start after a panic from any later one.
#[unsafe(link_section = ".uninit.panic_fresh")]
static mut FRESH: MaybeUninit<u32> = MaybeUninit::uninit();

/// Why the chip starts, if a panic is why. Reported once.
pub fn take() -> Option<PanicRecord> {
    // SAFETY: any bits are a word; only the panic handler, after which nothing else runs, and the one start use it.
    let fresh = unsafe {
        let fresh: *mut u32 = (&raw mut FRESH).cast();
        let was = read_volatile(fresh);
        write_volatile(fresh, 0);
        was
    };
    last().filter(|_| fresh == IS_FRESH)
}

/// What the RAM holds; `None` after power-on and where nothing panicked since.
fn last() -> Option<PanicRecord> {
    // SAFETY: any bits are words; only the panic handler writes them, after which nothing else runs.
    let words = unsafe { read_volatile((&raw const RECORD).cast()) };
    PanicRecord::from_words(&words)
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    static PANICKED: AtomicBool = AtomicBool::new(false);
    cortex_m::interrupt::disable();
    // The log may panic too; the first reason is the one to know.
    if !PANICKED.swap(true, Ordering::Relaxed) {
        let (file, line) = info.location().map_or(("", 0), |location| (location.file(), location.line()));
        let record = PanicRecord::new(last(), info.message(), file, line);
        // SAFETY: as in `last`; interrupts are off.
        unsafe {
            write_volatile((&raw mut RECORD).cast(), record.to_words());
            write_volatile((&raw mut FRESH).cast(), IS_FRESH);
        }
        cortex_m::asm::dsb();
        error!("{}", Display2Format(info));
    }
    SCB::sys_reset()
}
