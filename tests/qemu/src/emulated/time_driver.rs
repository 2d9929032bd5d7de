//! Time for embassy on the CMSDK timers of the mps2 boards: timer 0 counts freely and is extended to 64
//! bits by its interrupt, timer 1 is the alarm. Both count down at 25 MHz of the emulated clock; how many ticks make
//! a microsecond is for the program to say, because that clock need not be the time which it stands for.

use core::cell::RefCell;
use core::ptr::{read_volatile, write_volatile};
use core::sync::atomic::{AtomicU32, Ordering};
use core::task::Waker;

use cortex_m::interrupt::InterruptNumber;
use cortex_m::peripheral::NVIC;
use critical_section::Mutex;
use embassy_time_driver::Driver;
use embassy_time_queue_utils::Queue;

const ENABLE_WITH_INTERRUPT: u32 = 0b1001;

#[derive(Clone, Copy)]
pub struct Irq(pub u16);

// SAFETY: the numbers are constants of this program, below the 240 lines of a Cortex-M7's controller.
unsafe impl InterruptNumber for Irq {
    fn number(self) -> u16 {
        self.0
    }
}

pub const COUNTER_IRQ: Irq = Irq(8);
pub const ALARM_IRQ: Irq = Irq(9);

/// One CMSDK APB timer: its base address.
#[derive(Clone, Copy)]
struct Timer(usize);

const COUNTER: Timer = Timer(0x4000_0000);
const ALARM: Timer = Timer(0x4000_1000);

/// Registers of a timer, offsets in bytes.
const CONTROL: usize = 0x0;
const VALUE: usize = 0x4;
const RELOAD: usize = 0x8;
const INTERRUPT: usize = 0xC;

impl Timer {
    fn write(self, register: usize, value: u32) {
        // SAFETY: a register of a timer that the board has at this address; nothing else uses it.
        unsafe { write_volatile((self.0 + register) as *mut u32, value) }
    }

    fn read(self, register: usize) -> u32 {
        // SAFETY: as in `write`; reading has no side effect.
        unsafe { read_volatile((self.0 + register) as *const u32) }
    }

    fn start(self, ticks: u32) {
        self.write(RELOAD, ticks);
        self.write(VALUE, ticks);
        self.write(CONTROL, ENABLE_WITH_INTERRUPT);
    }

    fn stop(self) {
        self.write(CONTROL, 0);
        self.clear_interrupt();
    }

    fn clear_interrupt(self) {
        self.write(INTERRUPT, 1);
    }
}

pub struct Mps2Time {
    wraps: AtomicU32,
    ticks_per_us: AtomicU32,
    queue: Mutex<RefCell<Queue>>,
}

embassy_time_driver::time_driver_impl!(static TIME: Mps2Time = Mps2Time {
    wraps: AtomicU32::new(0),
    ticks_per_us: AtomicU32::new(1),
    queue: Mutex::new(RefCell::new(Queue::new())),
});

pub fn time() -> &'static Mps2Time {
    &TIME
}

impl Mps2Time {
    /// Start counting. Call once, before any executor runs.
    pub fn init(&self, ticks_per_us: u32) {
        self.ticks_per_us.store(ticks_per_us, Ordering::Relaxed);
        COUNTER.start(u32::MAX);
        // SAFETY: no critical section relies on these lines being masked, and their handlers may run
        // from here on.
        unsafe {
            NVIC::unmask(COUNTER_IRQ);
            NVIC::unmask(ALARM_IRQ);
        }
    }

    pub fn on_counter(&self) {
        critical_section::with(|_| {
            self.wraps.fetch_add(1, Ordering::Relaxed);
            COUNTER.clear_interrupt();
        });
    }

    pub fn on_alarm(&self) {
        critical_section::with(|cs| {
            ALARM.stop();
            self.arm(&mut self.queue.borrow_ref_mut(cs));
        });
    }

    fn ticks_per_us(&self) -> u64 {
        self.ticks_per_us.load(Ordering::Relaxed).into()
    }

    fn ticks(&self) -> u64 {
        critical_section::with(|_| {
            let mut wraps = self.wraps.load(Ordering::Relaxed);
            let mut low = u32::MAX - COUNTER.read(VALUE);
            if COUNTER.read(INTERRUPT) & 1 != 0 {
                // Wrapped, and the handler has not run yet.
                wraps += 1;
                low = u32::MAX - COUNTER.read(VALUE);
            }
            (u64::from(wraps) << 32) | u64::from(low)
        })
    }

    /// Wake whatever is due and set the alarm for what is next.
    fn arm(&self, queue: &mut Queue) {
        loop {
            let now = self.now();
            let next = queue.next_expiration(now);
            ALARM.stop();
            if next == u64::MAX {
                return;
            }
            if let Some(ahead) = next.checked_sub(self.now()).filter(|&ahead| ahead > 0) {
                // One that is further away than the timer reaches is set again when it fires.
                ALARM.start((ahead * self.ticks_per_us()).min(u64::from(u32::MAX)) as u32);
                return;
            }
        }
    }
}

impl Driver for Mps2Time {
    fn now(&self) -> u64 {
        self.ticks() / self.ticks_per_us()
    }

    fn schedule_wake(&self, at: u64, waker: &Waker) {
        critical_section::with(|cs| {
            let mut queue = self.queue.borrow_ref_mut(cs);
            if queue.schedule_wake(at, waker) {
                self.arm(&mut queue);
            }
        });
    }
}
