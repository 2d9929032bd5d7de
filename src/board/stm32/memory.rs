//! Memory attributes, caches, and where large objects live: what `board.x` promises is made true here.

use core::arch::asm;
use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::pac;
use slipsense::update::partitions::{FLASH_BASE, SECTOR_BYTES};

use crate::board::{PARTITIONS, SRAM_D2_BITS};

/// Attributes of an MPU region, ARMv7-M RASR: never executed, full access.
const EXECUTE_NEVER: u32 = 1 << 28;
const FULL_ACCESS: u32 = 0b011 << 24;
/// Normal memory, not cached, shared with other bus masters (TEX 001, C 0, B 0, S 1).
const NORMAL_UNCACHED: u32 = 0b001 << 19 | 1 << 18;
const ENABLE: u32 = 1;
/// Exponent field of a region of 2^`bits` bytes.
const fn size(bits: u32) -> u32 {
    (bits - 1) << 1
}

/// Of these the MPU has so many.
const REGIONS_MAX: u32 = 16;
/// Number of the first region of a sector of the flash that is written.
const SECTOR_REGION: u32 = REGIONS.len() as u32;
/// Sectors that are written.
const SECTORS: u32 = PARTITIONS.written().bytes() / SECTOR_BYTES;
const _: () = assert!(SECTOR_REGION + SECTORS <= REGIONS_MAX && SECTOR_BYTES.is_power_of_two());

/// Region number, base address, RASR. A higher number wins where regions overlap.
const REGIONS: [(u32, u32, u32); 2] = [
    // Subregions 3 to 6 of the whole 4 GB, 0x6000_0000 to 0xDFFF_FFFF: external memories that this board
    // does not have. No access, so that the core's speculative reads do not go there (AN4838).
    (0, 0x0000_0000, EXECUTE_NEVER | 0b1000_0111 << 8 | size(32) | ENABLE),
    // D2 SRAM: what DMA writes there, the CPU sees, and the other way round.
    (1, 0x3000_0000, EXECUTE_NEVER | FULL_ACCESS | NORMAL_UNCACHED | size(SRAM_D2_BITS) | ENABLE),
];

unsafe extern "C" {
    // Of `board.x`.
    static mut __itcm_start: u32;
    static mut __itcm_end: u32;
    static __itcm_image: u32;
}

/// Bring the inner loops to ITCM, whose address is where the linker put their calls.
///
/// The core's TCMs are on after reset (RM0433, embedded SRAM).
fn fill_itcm() {
    let (start, end, image) = (&raw mut __itcm_start, &raw mut __itcm_end, &raw const __itcm_image);
    // SAFETY: the linker gives the bounds of the section and its image in flash, both aligned to words; nothing
    // runs there yet. Assembly, because to Rust the section is code and no object to be written.
    unsafe {
        asm!(
            "b 3f",
            "2: ldr {word}, [{from}], #4",
            "str {word}, [{to}], #4",
            "3: cmp {to}, {end}",
            "bne 2b",
            word = out(reg) _,
            from = inout(reg) image => _,
            to = inout(reg) start => _,
            end = in(reg) end,
            options(nostack),
        );
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}

/// Fill ITCM, switch on the D2 SRAM clocks, the MPU and both caches. First thing after reset, before any DMA.
pub fn init(core: &mut cortex_m::Peripherals) {
    fill_itcm();
    // Gated at reset, and embassy-stm32 0.6 leaves them so.
    pac::RCC.ahb2enr().modify(|w| {
        w.set_sram1en(true);
        w.set_sram2en(true);
    });
    cortex_m::asm::dsb();
    // SAFETY: the regions deny only addresses without memory and take the cache from D2 SRAM, which holds nothing yet,
    // and from the flash that is written, which nothing has read; everything else keeps the default map (PRIVDEFENA).
    // The MPU is off meanwhile.
    unsafe {
        core.MPU.ctrl.write(0);
        let written = (0..SECTORS).map(|sector| {
            let base = FLASH_BASE + PARTITIONS.written().start + sector * SECTOR_BYTES;
            let bits = SECTOR_BYTES.trailing_zeros();
            let attributes = EXECUTE_NEVER | FULL_ACCESS | NORMAL_UNCACHED | size(bits) | ENABLE;
            (SECTOR_REGION + sector, base, attributes)
        });
        for (number, base, attributes) in REGIONS.into_iter().chain(written) {
            core.MPU.rnr.write(number);
            core.MPU.rbar.write(base);
            core.MPU.rasr.write(attributes);
        }
        core.MPU.ctrl.write(1 << 2 | 1);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
}

/// A static in a RAM that nothing zeroes at boot: taken once, then written. A `StaticCell` would keep
/// its own flag in that memory.
pub struct Slot<T> {
    taken: AtomicBool,
    place: *mut MaybeUninit<T>,
}

// SAFETY: `place` is handed out once, whoever asks; `T` goes where it is `Send`.
unsafe impl<T: Send> Sync for Slot<T> {}

impl<T> Slot<T> {
    /// # Safety
    /// `place` is a static that nothing else names.
    pub const unsafe fn new(place: *mut MaybeUninit<T>) -> Self {
        Self { taken: AtomicBool::new(false), place }
    }

    /// The place; `None` the second time.
    pub fn take(&self) -> Option<&'static mut MaybeUninit<T>> {
        if self.taken.swap(true, Ordering::AcqRel) {
            return None;
        }
        // SAFETY: `new` promises a static of its own, and the flag lets one caller here.
        Some(unsafe { &mut *self.place })
    }
}

/// A [`Slot`] of this name and type in AXI SRAM: for the CPU.
macro_rules! axi_sram_slot {
    ($(#[$doc:meta])* $name:ident: $type:ty) => {
        $crate::stm32::memory::slot_in!(".axisram", $(#[$doc])* $name: $type);
    };
}
pub(crate) use axi_sram_slot;

/// A [`Slot`] of this name and type in D2 SRAM: for the CPU and DMA1 and DMA2, never cached.
macro_rules! dma_slot {
    ($(#[$doc:meta])* $name:ident: $type:ty) => {
        $crate::stm32::memory::slot_in!(".sram_d2", $(#[$doc])* $name: $type);
    };
}
pub(crate) use dma_slot;

macro_rules! slot_in {
    ($section:literal, $(#[$doc:meta])* $name:ident: $type:ty) => {
        $(#[$doc])*
        static $name: $crate::stm32::memory::Slot<$type> = {
            #[unsafe(link_section = $section)]
            static mut PLACE: ::core::mem::MaybeUninit<$type> = ::core::mem::MaybeUninit::uninit();
            // SAFETY: `PLACE` is visible in this block only.
            unsafe { $crate::stm32::memory::Slot::new(&raw mut PLACE) }
        };
    };
}
pub(crate) use slot_in;
