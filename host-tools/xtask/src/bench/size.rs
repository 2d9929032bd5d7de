//! What the firmware takes of flash and RAM, section by section.

use std::path::Path;

use anyhow::Result;
use serde::Serialize;

use crate::elf::{Image, Kind};

/// Memory of the board that a section lies in.
#[derive(Clone, Debug, Serialize)]
pub struct SectionSize {
    pub name: String,
    pub address: u64,
    pub bytes: u64,
    /// Takes flash: code, constants, and the first content of data.
    pub in_flash: bool,
    /// Takes RAM.
    pub in_ram: bool,
}

/// A firmware.
#[derive(Clone, Debug, Serialize)]
pub struct Size {
    pub sections: Vec<SectionSize>,
    pub flash_bytes: u64,
    /// Without the stack.
    pub ram_bytes: u64,
    /// Of the flash: the model file.
    pub model_bytes: usize,
}

pub fn measure(elf: &Path, model: &[u8]) -> Result<Size> {
    let image = Image::read(elf)?;
    let sections: Vec<_> = image
        .sections
        .iter()
        .map(|section| SectionSize {
            name: section.name.clone(),
            address: section.address,
            bytes: section.bytes,
            in_flash: section.kind != Kind::Zeroed,
            in_ram: matches!(section.kind, Kind::Data | Kind::Zeroed),
        })
        .collect();
    let sum = |is: fn(&SectionSize) -> bool| sections.iter().filter(|s| is(s)).map(|s| s.bytes).sum();
    Ok(Size {
        flash_bytes: sum(|section| section.in_flash),
        ram_bytes: sum(|section| section.in_ram),
        model_bytes: model.len(),
        sections,
    })
}
