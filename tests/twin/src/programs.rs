//! What a debug probe has written into flash: the firmware, and a bootloader in the place of the two words that lead
//! past it.

use std::ops::Range;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use rigless::image::Image;
use slipsense::update::partitions::{FLASH_BASE, NUCLEO_H743ZI2, Partitions, Span};

pub const BOARD: &Partitions = &NUCLEO_H743ZI2;
/// Where the firmware's vector table is.
pub const VECTORS: u64 = (FLASH_BASE + BOARD.active.start) as u64;

/// Where it is in the part's addresses.
pub fn addresses(span: Span) -> Range<u64> {
    u64::from(FLASH_BASE + span.start)..u64::from(FLASH_BASE + span.end)
}

/// The images to place; `firmware` is the file's content.
pub fn images(elf: &Path, firmware: Vec<u8>, boot: Option<&Path>) -> Result<Vec<Image>> {
    let whole = Image::new(elf, firmware, None)?;
    let Some(boot) = boot else { return Ok(vec![whole]) };
    let bytes =
        std::fs::read(boot).with_context(|| format!("{}: cannot read the bootloader", boot.display()))?;
    let mut images = vec![Image::new(boot, bytes, None)?];
    let slot = addresses(BOARD.active);
    for (address, bytes) in whole.segments().filter(|(address, _)| slot.contains(address)) {
        images.push(Image::new(elf, bytes.to_vec(), Some(address))?);
    }
    ensure!(images.len() > 1, "{}: nothing of it lies in the slot of a firmware", elf.display());
    Ok(images)
}
