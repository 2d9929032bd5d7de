//! Memory attributes, caches, and the RAMs that cortex-m-rt does not know: what `board.x` promises is made true here.
//!
//! A static goes to AXI SRAM, for the CPU, by `#[unsafe(link_section = ".axisram")]`, to D2 SRAM 2, for the CPU too, by
//! `".sram2"`, and to D2 SRAM 1, for the CPU and DMA1 and DMA2, never cached, by `".sram_d2"`. All are zeroed by [`init`]
//! whatever their initial value says, so it is one whose bytes are zeros, such as an empty `StaticCell`.
//!
//! No `StaticCell` lies in `.sram_d2`: taking one is an exclusive access (LDREX). In memory that is shared and not cached
//! the bus has to answer it, which that of the STM32H7 does not: the core faults, others report (not run here).

use core::arch::{asm, global_asm};

use embassy_stm32::pac;

use crate::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2 as BOARD, SECTOR_BYTES};

/// Attributes of an MPU region, ARMv7-M RASR: never executed, full access.
const EXECUTE_NEVER: u32 = 1 << 28;
const FULL_ACCESS: u32 = 0b011 << 24;
const READ_ONLY: u32 = 0b101 << 24;
/// Normal memory, not cached, shared with other bus masters (TEX 001, C 0, B 0, S 1).
const NORMAL_UNCACHED: u32 = 0b001 << 19 | 1 << 18;
/// Device memory, shared (TEX 000, C 0, B 1): never read by speculation.
const DEVICE: u32 = 1 << 16;
const ENABLE: u32 = 1;
/// Exponent field of a region of 2^`bits` bytes.
const fn size(bits: u32) -> u32 {
    (bits - 1) << 1
}

const MPU_REGIONS: u32 = 16;
/// Number of the first region that is a sector of the flash that is written.
const FIRST_SECTOR_REGION: u32 = REGIONS.len() as u32;
const SECTORS: u32 = BOARD.written().bytes() / SECTOR_BYTES;
const _: () = assert!(FIRST_SECTOR_REGION + SECTORS <= MPU_REGIONS && SECTOR_BYTES.is_power_of_two());

/// Region number, base address, RASR. A higher number wins where regions overlap.
const REGIONS: [(u32, u32, u32); 4] = [
    // Subregions 3 to 6 of the whole 4 GB, 0x6000_0000 to 0xDFFF_FFFF: external memories that this board
    // does not have. No access, so that the core's speculative reads do not go there (AN4838).
    (0, 0x0000_0000, EXECUTE_NEVER | 0b1000_0111 << 8 | size(32) | ENABLE),
    // D2 SRAM 1: what DMA writes there, the CPU sees, and the other way round.
    (1, 0x3000_0000, EXECUTE_NEVER | FULL_ACCESS | NORMAL_UNCACHED | size(17) | ENABLE),
    // System memory and what is reserved behind it: no access. Reads of the core's own speculation there raise RDPERR
    // and RDSERR (RM0433, FLASH_SR), which fail the operation of the flash that is under way.
    (2, 0x1FF0_0000, EXECUTE_NEVER | size(20) | ENABLE),
    // In there the unique identifier, at 0x1FF1_E800.
    (3, 0x1FF1_E000, EXECUTE_NEVER | READ_ONLY | DEVICE | size(12) | ENABLE),
];

// For the linker, which checks the memory maps by it (`bin/app/board.x`, `bin/boot/board.x`).
global_asm!(
    ".global __boot_start, __boot_end, __active_start, __active_end",
    ".set __boot_start, {boot_start}",
    ".set __boot_end, {boot_end}",
    ".set __active_start, {active_start}",
    ".set __active_end, {active_end}",
    boot_start = const FLASH_BASE + BOARD.boot.start,
    boot_end = const FLASH_BASE + BOARD.boot.end,
    active_start = const FLASH_BASE + BOARD.active.start,
    active_end = const FLASH_BASE + BOARD.active.end,
);

unsafe extern "C" {
    // Of `board.x`.
    static mut __itcm_start: u32;
    static mut __itcm_end: u32;
    static __itcm_image: u32;
    static mut __axisram_start: u32;
    static mut __axisram_end: u32;
    static mut __sram_d2_start: u32;
    static mut __sram_d2_end: u32;
    static mut __sram2_start: u32;
    static mut __sram2_end: u32;
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

/// Write zeros to the words of a section.
///
/// # Safety
/// `start` and `end` are the bounds of a section that holds no object yet, aligned to words.
unsafe fn zero(start: *mut u32, end: *mut u32) {
    // SAFETY: as promised. Assembly, because to Rust the section is objects of their own.
    unsafe {
        asm!(
            "b 3f",
            "2: str {zero}, [{to}], #4",
            "3: cmp {to}, {end}",
            "bne 2b",
            zero = in(reg) 0,
            to = inout(reg) start => _,
            end = in(reg) end,
            options(nostack),
        );
    }
}

/// Where the inner loops run, and their image in flash.
pub fn inner_loops() -> [&'static [u8]; 2] {
    let (start, end) = (&raw const __itcm_start, &raw const __itcm_end);
    let bytes = end as usize - start as usize;
    // SAFETY: the linker gives the bounds of the section and its image, which nothing writes after `fill_itcm`.
    [start, &raw const __itcm_image].map(|at| unsafe { core::slice::from_raw_parts(at.cast(), bytes) })
}

/// Fill ITCM, zero AXI and D2 SRAM, switch on the D2 SRAM clocks, the MPU and both caches. First thing after reset, before any DMA.
pub fn init(core: &mut cortex_m::Peripherals) {
    fill_itcm();
    // Gated at reset, and embassy-stm32 0.6 leaves them so.
    pac::RCC.ahb2enr().modify(|w| {
        w.set_sram1en(true);
        w.set_sram2en(true);
    });
    cortex_m::asm::dsb();
    // SAFETY: the linker gives the bounds of the sections; `main` begins here, so nothing uses a static there yet.
    unsafe {
        zero(&raw mut __axisram_start, &raw mut __axisram_end);
        zero(&raw mut __sram_d2_start, &raw mut __sram_d2_end);
        zero(&raw mut __sram2_start, &raw mut __sram2_end);
    }
    protect(&mut core.MPU);
    core.SCB.enable_icache();
    core.SCB.enable_dcache(&mut core.CPUID);
}

/// Set the MPU up, also for the bootloader, before any cache is on.
pub fn protect(mpu: &mut cortex_m::peripheral::MPU) {
    // SAFETY: the regions deny only addresses without memory of ours and take the cache from D2 SRAM, which holds zeros,
    // and from the flash that is written, which nothing has read; everything else keeps the default map (PRIVDEFENA).
    // The MPU is off meanwhile.
    unsafe {
        mpu.ctrl.write(0);
        let written = (0..SECTORS).map(|sector| {
            let base = FLASH_BASE + BOARD.written().start + sector * SECTOR_BYTES;
            let bits = SECTOR_BYTES.trailing_zeros();
            let attributes = EXECUTE_NEVER | FULL_ACCESS | NORMAL_UNCACHED | size(bits) | ENABLE;
            (FIRST_SECTOR_REGION + sector, base, attributes)
        });
        for (number, base, attributes) in REGIONS.into_iter().chain(written) {
            mpu.rnr.write(number);
            mpu.rbar.write(base);
            mpu.rasr.write(attributes);
        }
        mpu.ctrl.write(1 << 2 | 1);
    }
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
}
