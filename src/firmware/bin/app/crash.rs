//! A panic, a fault, a task that stands still: the record goes into RAM that a reset does not clear, then the node
//! restarts and says so.

use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m_rt::{ExceptionFrame, exception};
use defmt::{Display2Format, error};
use embassy_stm32::pac;
use embassy_time::{Duration, Ticker};
use slipsense::board::crash_record::{CRASH_WORDS, CrashRecord, Fault, ResetCause, Start};
use slipsense::firmware::shared::SHARED;
use slipsense::tasks::StallWatch;

/// In DTCM, which is not cached: what is written is there after the reset.
#[unsafe(link_section = ".uninit.crash_record")]
static mut RECORD: MaybeUninit<[u32; CRASH_WORDS]> = MaybeUninit::uninit();

/// In [`FRESH`]: the record is why the chip starts.
const IS_FRESH: u32 = u32::from_le_bytes(*b"new!");
/// Tells the start after a crash from any later one.
#[unsafe(link_section = ".uninit.crash_fresh")]
static mut FRESH: MaybeUninit<u32> = MaybeUninit::uninit();

/// Tasks that stood still at the last look.
#[unsafe(link_section = ".uninit.stalled")]
static mut STALLED: MaybeUninit<u32> = MaybeUninit::uninit();
/// Time between two looks: twice within the watchdog's period, and longer than any task rests.
const LOOK: Duration = Duration::from_millis(30);

/// CFSR.BFARVALID and CFSR.MMARVALID.
const ADDRESS_VALID: u32 = 1 << 15 | 1 << 7;

/// How the chip came to start. A crash is reported once.
pub fn start() -> Start {
    let cause = ResetCause::from_flags(pac::RCC.rsr().read().0);
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    // SAFETY: any bits are a word; only the handlers, after which nothing else runs, the watch, which has not begun, and
    // the one start use them.
    let (fresh, stalled) = unsafe {
        let fresh: *mut u32 = (&raw mut FRESH).cast();
        let was = read_volatile(fresh);
        write_volatile(fresh, 0);
        (was == IS_FRESH, read_volatile((&raw const STALLED).cast::<u32>()))
    };
    let crash = match cause {
        _ if fresh => last(),
        ResetCause::Watchdog => {
            let record = CrashRecord::stall(last(), stalled as u8);
            keep(&record);
            Some(record)
        }
        _ => None,
    };
    Start { cause, crash }
}

/// Note which tasks stand still, for ever.
pub async fn watch() {
    let (mut watch, mut ticker) = (StallWatch::new(), Ticker::every(LOOK));
    loop {
        let stalled = watch.look(&SHARED.progress);
        // SAFETY: nothing else uses the word while this runs.
        unsafe { write_volatile((&raw mut STALLED).cast(), u32::from(stalled)) };
        ticker.next().await;
    }
}

/// What the RAM holds; `None` after power-on and where nothing crashed since.
fn last() -> Option<CrashRecord> {
    // SAFETY: any bits are words; only the handlers and the start write them.
    let words = unsafe { read_volatile((&raw const RECORD).cast()) };
    CrashRecord::from_words(&words)
}

fn keep(record: &CrashRecord) {
    // SAFETY: as in `last`; whoever calls this runs alone.
    unsafe { write_volatile((&raw mut RECORD).cast(), record.to_words()) };
    cortex_m::asm::dsb();
}

/// Keep the first record of this run, for the next start to report. `true`: this is the first.
fn keep_first(record: impl FnOnce() -> CrashRecord) -> bool {
    static CRASHED: AtomicBool = AtomicBool::new(false);
    cortex_m::interrupt::disable();
    // The log may crash too; the first reason is the one to know.
    if CRASHED.swap(true, Ordering::Relaxed) {
        return false;
    }
    keep(&record());
    // SAFETY: as in `last`; interrupts are off.
    unsafe { write_volatile((&raw mut FRESH).cast(), IS_FRESH) };
    cortex_m::asm::dsb();
    true
}

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    let (file, line) = info.location().map_or(("", 0), |location| (location.file(), location.line()));
    if keep_first(|| CrashRecord::new(last(), info.message(), file, line)) {
        error!("{}", Display2Format(info));
    }
    SCB::sys_reset()
}

/// # Safety
/// Called by the hardware only. All faults end here: the others are not enabled.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    // SAFETY: registers that reading does not change; nothing else runs.
    let (cfsr, mmfar, bfar) = unsafe {
        let scb = &*SCB::PTR;
        (scb.cfsr.read(), scb.mmfar.read(), scb.bfar.read())
    };
    let address = match cfsr & ADDRESS_VALID {
        0 => 0,
        valid if valid & 1 << 7 != 0 => mmfar,
        _ => bfar,
    };
    let fault = Fault { pc: frame.pc(), lr: frame.lr(), cfsr, address };
    // Not into the log, whose depth the stack has no room for on top of all else: the next start says it.
    keep_first(|| CrashRecord::fault(last(), fault));
    SCB::sys_reset()
}
