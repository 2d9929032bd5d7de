//! A panic, a fault, a task that stands still: the record goes into RAM that a reset does not clear, then the node
//! restarts and says so.

use core::arch::naked_asm;
use core::mem::MaybeUninit;
use core::panic::PanicInfo;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{AtomicBool, Ordering};

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{SCB, SYST};
use cortex_m_rt::{ExceptionFrame, exception};
use defmt::{Display2Format, error};
use embassy_stm32::pac;
use slipsense::board::crash_record::{CRASH_WORDS, CrashKind, CrashRecord, Fault, ResetCause, Stall, Start};
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

/// Starts since the supply came, this one not counted, and its complement: other bits are what the supply left.
#[unsafe(link_section = ".uninit.starts")]
static mut STARTS: MaybeUninit<[u32; 2]> = MaybeUninit::uninit();

/// What the last look saw: tasks, PC, LR.
#[unsafe(link_section = ".uninit.stalled")]
static mut STALLED: MaybeUninit<[u32; 3]> = MaybeUninit::uninit();
/// SysTick's alone.
static mut WATCH: StallWatch = StallWatch::new();
/// Cycles between two looks, the most that SysTick counts: 35 ms, twice within the watchdog's period, and longer than any
/// task rests. It pauses while a debugger halts the core, as the watchdog does.
const LOOK_CYCLES: u32 = 0x00FF_FFFF;

/// CFSR.BFARVALID and CFSR.MMARVALID.
const ADDRESS_VALID: u32 = 1 << 15 | 1 << 7;

/// How the chip came to start. A crash is reported once.
pub fn start() -> Start {
    let cause = ResetCause::from_flags(pac::RCC.rsr().read().0);
    // The bit stays set, and its flags cleared, until it is written 0 (RM0433, RCC_RSR).
    pac::RCC.rsr().modify(|w| w.set_rmvf(true));
    pac::RCC.rsr().modify(|w| w.set_rmvf(false));
    // SAFETY: any bits are a word; only the handlers, after which nothing else runs, the watch, which has not begun, and
    // the one start use them.
    let (fresh, stalled) = unsafe {
        let fresh: *mut u32 = (&raw mut FRESH).cast();
        let was = read_volatile(fresh);
        write_volatile(fresh, 0);
        (was == IS_FRESH, read_volatile((&raw const STALLED).cast::<[u32; 3]>()))
    };
    let crash = match cause {
        _ if fresh => last(),
        ResetCause::Watchdog => {
            let [tasks, pc, lr] = stalled;
            let stall = Stall { tasks: tasks as u8, pc, lr };
            let record = CrashRecord::of(last(), CrashKind::Stall(stall));
            keep(&record);
            Some(record)
        }
        _ => None,
    };
    Start { cause, crash }
}

/// Starts since the supply came, this one not counted; wraps. To be called once.
pub fn count_start() -> u8 {
    let words: *mut [u32; 2] = (&raw mut STARTS).cast();
    // SAFETY: any bits are words; nobody else uses them.
    let starts = match unsafe { read_volatile(words) } {
        [starts, complement] if starts == !complement => starts.wrapping_add(1),
        _ => 0,
    };
    // SAFETY: as above.
    unsafe { write_volatile(words, [starts, !starts]) };
    starts as u8
}

/// Note from now on, in SysTick, which tasks stand still and where the core is.
pub fn watch(systick: &mut SYST) {
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(LOOK_CYCLES);
    systick.clear_current();
    systick.enable_counter();
    systick.enable_interrupt();
}

/// Not by the macro, which does not give where the core was. Everything runs on the main stack.
///
/// # Safety
/// Called by the hardware only.
#[unsafe(naked)]
#[unsafe(no_mangle)]
unsafe extern "C" fn SysTick() {
    naked_asm!("mrs r0, MSP", "b {look}", look = sym look)
}

/// # Safety
/// `frame` is what the exception put on the stack.
unsafe extern "C" fn look(frame: *const ExceptionFrame) {
    // SAFETY: as promised; nothing else uses the statics while this runs.
    unsafe {
        let stalled = (*(&raw mut WATCH)).look(&SHARED.progress);
        let seen = [stalled.into(), (*frame).pc(), (*frame).lr()];
        write_volatile((&raw mut STALLED).cast(), seen);
    }
}

/// The start found no clock: see [`slipsense::firmware::wait_for_the_clock`]. For the start that follows.
pub fn no_clock(found_hz: u32) {
    keep_first(|| CrashRecord::of(last(), CrashKind::NoClock(found_hz)));
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
    keep_first(|| CrashRecord::of(last(), CrashKind::Fault(fault)));
    SCB::sys_reset()
}
