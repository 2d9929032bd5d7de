//! The node on the emulated board: frames on its first serial port, time from its first timer, flash in RAM
//! that a reset leaves alone.

use core::mem::MaybeUninit;
use core::ptr::{addr_of_mut, read_volatile, write_volatile};

use cortex_m::peripheral::SCB;
use cortex_m_rt::entry;
use panic_semihosting as _;
use slipsense::wire::CanFrame;
use slipsense_qemu::link::{Decoder, RECORD_MAX, encode};
use slipsense_qemu::node_loop::{Link, serve};
use slipsense_qemu::ram_flash::FLASH_BYTES;

// CMSDK peripherals of the mps2-an500 (Arm DDI 0479, sections 4.3 and 4.2; Arm DAI 0400, memory map).
const UART_DATA: usize = 0x4000_4000;
const UART_STATE: usize = 0x4000_4004;
const UART_CONTROL: usize = 0x4000_4008;
const UART_DIVIDER: usize = 0x4000_4010;
const UART_SEND_FULL: u32 = 1;
const UART_RECEIVE_FULL: u32 = 2;
const UART_SEND_AND_RECEIVE: u32 = 3;
const TIMER_CONTROL: usize = 0x4000_0000;
const TIMER_VALUE: usize = 0x4000_0004;
const TIMER_RELOAD: usize = 0x4000_0008;
const TIMER_TICKS_PER_US: u64 = 25;

/// What the flash holds in front, once it was erased for the first time.
const KNOWN: u64 = 0x534C_4950_464C_5348;

/// Keeps its content through a reset.
#[unsafe(link_section = ".uninit.flash")]
static mut FLASH: MaybeUninit<(u64, [u8; FLASH_BYTES])> = MaybeUninit::uninit();

fn read(address: usize) -> u32 {
    // SAFETY: called with registers that the board has; reading the data register only takes a byte.
    unsafe { read_volatile(address as *const u32) }
}

fn write(address: usize, value: u32) {
    // SAFETY: as in `read`; nothing else uses these registers.
    unsafe { write_volatile(address as *mut u32, value) }
}

struct Serial {
    decoder: Decoder,
    /// Counts down from `u32::MAX`.
    timer: core::cell::Cell<u32>,
    ticks: core::cell::Cell<u64>,
}

impl Link for Serial {
    fn receive(&mut self) -> Option<(CanFrame, u64)> {
        while read(UART_STATE) & UART_RECEIVE_FULL != 0 {
            if let Some(frame) = self.decoder.accept(read(UART_DATA) as u8) {
                return Some((frame, self.now_us()));
            }
        }
        None
    }

    fn send(&mut self, frame: &CanFrame) {
        let mut record = [0; RECORD_MAX];
        let length = encode(frame, &mut record);
        for &byte in &record[..length] {
            while read(UART_STATE) & UART_SEND_FULL != 0 {}
            write(UART_DATA, byte.into());
        }
    }

    /// Called far more often than the timer wraps, every 171 s.
    fn now_us(&self) -> u64 {
        let value = read(TIMER_VALUE);
        let passed = self.timer.replace(value).wrapping_sub(value);
        self.ticks.set(self.ticks.get() + u64::from(passed));
        self.ticks.get() / TIMER_TICKS_PER_US
    }

    fn idle(&mut self) {}
}

#[entry]
fn main() -> ! {
    write(UART_DIVIDER, 16);
    write(UART_CONTROL, UART_SEND_AND_RECEIVE);
    write(TIMER_RELOAD, u32::MAX);
    write(TIMER_VALUE, u32::MAX);
    write(TIMER_CONTROL, 1);
    // SAFETY: this function runs once after each reset, and nothing else names the flash. Any bits are
    // values of its type.
    let (known, flash) = unsafe { &mut *addr_of_mut!(FLASH).cast::<(u64, [u8; FLASH_BYTES])>() };
    if *known != KNOWN {
        flash.fill(0xFF);
        *known = KNOWN;
    }
    let mut serial = Serial {
        decoder: Decoder::default(),
        timer: core::cell::Cell::new(u32::MAX),
        ticks: core::cell::Cell::new(0),
    };
    serve(&mut serial, flash, *b"slipsense qemu 1");
    SCB::sys_reset()
}
