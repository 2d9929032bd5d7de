//! Errors that the error correction of the RAMs finds, by its monitors (RM0433, RAM ECC monitoring). stm32-metapac has
//! no registers of this peripheral.

use core::sync::atomic::{AtomicU32, Ordering};

/// RAMECC1 to RAMECC3, of the RAMs of domains 1 to 3: base and number of monitors.
const PERIPHERALS: [(usize, usize); 3] = [(0x5200_9000, 5), (0x4802_3000, 5), (0x5802_7000, 2)];
/// From the base to the first monitor, and from one to the next; in a monitor to its status, bytes.
const MONITOR: usize = 0x20;
const STATUS: usize = 4;
/// SEDCF: one bit, mended.
const SINGLE: u32 = 1;
/// DEDF and DEBWDF: two bits, lost; the second when a part of the word was written.
const DOUBLE: u32 = 0b110;

static ERRORS: [AtomicU32; 2] = [const { AtomicU32::new(0) }; 2];

/// What stands in the status of each monitor, which it clears.
fn take_flags() -> impl Iterator<Item = u32> {
    let monitors = |(base, count): (usize, usize)| (1..=count).map(move |monitor| base + MONITOR * monitor);
    PERIPHERALS.into_iter().flat_map(monitors).map(|monitor| {
        let status = (monitor + STATUS) as *mut u32;
        // SAFETY: the address is that of a status register, which nothing else uses; its flags are cleared by zeros.
        unsafe {
            let flags = status.read_volatile();
            if flags != 0 {
                status.write_volatile(0);
            }
            flags
        }
    })
}

/// Forget what is there: words are read, or written in part, before anything has filled the RAMs.
pub fn forget() {
    take_flags().for_each(drop);
}

/// Count what was found since the last call, once in each RAM: errors of one bit, of two. Counts since [`forget`].
pub fn count() -> [u32; 2] {
    for flags in take_flags() {
        for (count, mask) in ERRORS.iter().zip([SINGLE, DOUBLE]) {
            count.fetch_add((flags & mask != 0).into(), Ordering::Relaxed);
        }
    }
    ERRORS.each_ref().map(|count| count.load(Ordering::Relaxed))
}
