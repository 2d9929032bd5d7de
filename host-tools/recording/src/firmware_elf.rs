//! A firmware's ELF file as the bytes of its slot.

use anyhow::{Context, Result, bail, ensure};
use object::LittleEndian;
use object::elf::{self, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use slipsense::update::partitions::{FLASH_BASE, Partitions, TRAILER_BYTES};

/// Does it begin as an ELF file?
pub fn is_elf(file: &[u8]) -> bool {
    file.starts_with(&elf::ELFMAG)
}

/// What the program holds in its slot, from the slot's first byte on. What it writes elsewhere belongs to a probe: the
/// words in the bootloader's place, and the blank trailer. Errors begin with `name`.
pub fn flatten(file: &[u8], name: &str, board: &Partitions) -> Result<Vec<u8>> {
    let no_program = || format!("{name}: is not a program of the microcontroller");
    let header = elf::FileHeader32::<LittleEndian>::parse(file).with_context(no_program)?;
    let endian = header.endian().with_context(no_program)?;
    ensure!(header.e_machine(endian) == elf::EM_ARM, "{name}: is a program of another machine");
    let slot = FLASH_BASE + board.active.start..FLASH_BASE + board.active.end - TRAILER_BYTES;
    let mut payload = Vec::new();
    for segment in header.program_headers(endian, file).with_context(no_program)? {
        let address = segment.p_paddr(endian);
        let Ok(data) = segment.data(endian, file) else { bail!("{name}: is cut short") };
        if segment.p_type(endian) != PT_LOAD || data.is_empty() || !slot.contains(&address) {
            continue;
        }
        let begin = (address - slot.start) as usize;
        let end = begin + data.len();
        ensure!(
            end <= slot.len(),
            "{name}: the program leaves its slot, {} bytes from {:#x} on",
            slot.len(),
            slot.start
        );
        payload.resize(payload.len().max(end), 0xFF);
        payload[begin..end].copy_from_slice(data);
    }
    ensure!(!payload.is_empty(), "{name}: nothing of the program lies in the slot of the {}", board.label);
    Ok(payload)
}
