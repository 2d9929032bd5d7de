//! What a firmware finds out about itself when it starts.

use embedded_storage_async::nor_flash::ReadNorFlash;

use super::Refusal;
use super::image::Header;
use super::key::Keys;
use super::partitions::{FLASH_BASE, Partitions};
use super::slot::{firmware_header_at, header_bytes, vectors};

/// Is there a bootloader that would swap? `boot` is its partition, from its address 0 on.
///
/// Where reset looks first, a program that a probe wrote without a bootloader has two words that lead to itself
/// (`board.x`); a bootloader begins in its own partition.
pub async fn find_bootloader<F: ReadNorFlash>(boot: &mut F, board: &Partitions) -> Result<(), Refusal> {
    let span = board.boot;
    let mut bytes = [0; 8];
    boot.read(0, &mut bytes).await.map_err(|_| Refusal::Flash)?;
    let (_, reset) = vectors(bytes);
    let is_there = reset & 1 == 1 && (FLASH_BASE + span.start..FLASH_BASE + span.end).contains(&reset);
    if is_there { Ok(()) } else { Err(Refusal::NoBootloader) }
}

/// The signed header of the firmware that runs, which the bootloader has held against the rest of it; `None` where a probe
/// wrote it. `active` is its slot, from its address 0 on.
pub async fn running_header<F: ReadNorFlash>(
    active: &mut F,
    board: &Partitions,
    keys: &Keys,
) -> Option<Header> {
    let bytes = header_bytes(active, firmware_header_at(board)).await.ok()?;
    Header::verify(&bytes, keys).ok()
}
