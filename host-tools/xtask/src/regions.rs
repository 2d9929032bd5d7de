//! What the firmware takes of each region of the board's memory map, and of 512 KB of flash.

use std::fs;

use anyhow::{Context, Result, ensure};

use crate::elf::Image;
use crate::firmware::{BOARD, MEMORY_MAP};
use crate::process::root;
use crate::table::{Table, thousands};
use crate::toolchain::Toolchain;

/// Code, constants, model and first contents of RAM: what an update carries, at most. `board.x` asserts it too.
const FLASH_BYTES_MAX: u64 = 512 * 1024;

/// What has to be left of the region that code is linked to.
const FLASH_SPARE_BYTES: u64 = 4 * 1024;
/// By how much the code of rustup's compiler is longer than Debian's, 3.1 KB when last built with both: a firmware that
/// one of them fits has to fit with the other.
const LONGER_BY_RUSTUP_BYTES: u64 = 4 * 1024;
const CODE: &str = "FLASH";

struct Region {
    name: String,
    address: u64,
    bytes: u64,
    /// By sections that lie there when the program runs; none of the stack.
    used_bytes: u64,
}

pub struct Regions {
    regions: Vec<Region>,
    /// Everything that is programmed into flash.
    flash_bytes: u64,
    /// What has to be left, by the compiler that made it.
    least_spare_bytes: u64,
}

impl Regions {
    pub fn new(image: &Image) -> Result<Self> {
        let map = fs::read_to_string(root().join(MEMORY_MAP)).context(MEMORY_MAP)?;
        let mut regions: Vec<_> = map.lines().filter_map(region).collect();
        ensure!(!regions.is_empty(), "{MEMORY_MAP}: no region found");
        for section in &image.sections {
            let holds = |region: &&mut Region| {
                (region.address..region.address + region.bytes).contains(&section.address)
            };
            let region = regions.iter_mut().find(holds);
            let region = region.with_context(|| format!("section {} lies in no region", section.name))?;
            region.used_bytes += section.bytes;
        }
        let flash = image.sections.iter().filter(|section| section.is_in_flash);
        let longer = match Toolchain::get()? {
            Toolchain::Debian => LONGER_BY_RUSTUP_BYTES,
            Toolchain::Host => 0,
        };
        let flash_bytes = flash.map(|section| section.bytes).sum();
        Ok(Self { regions, flash_bytes, least_spare_bytes: FLASH_SPARE_BYTES + longer })
    }

    pub fn fits(&self) -> bool {
        self.flash_bytes <= FLASH_BYTES_MAX
            && self.spare_bytes() >= self.least_spare_bytes as i64
            && self.regions.iter().all(|r| r.used_bytes <= r.bytes)
    }

    /// What is left of the region of the code by all that is programmed.
    fn spare_bytes(&self) -> i64 {
        let code = self.regions.iter().find(|region| region.name == CODE);
        code.map_or(0, |region| region.bytes as i64) - self.flash_bytes as i64
    }

    pub fn table(&self) -> Table {
        let title = format!("Memory of the firmware, bytes, the model included ({BOARD})");
        let mut table = Table::new(title, &["region", "used", "of"]);
        for Region { name, bytes, used_bytes, .. } in &self.regions {
            table.row([name.clone(), thousands(*used_bytes), thousands(*bytes)]);
        }
        let programmed = "all that is programmed".to_owned();
        table.row([programmed, thousands(self.flash_bytes), thousands(FLASH_BYTES_MAX)]);
        let left = format!("left of {CODE} by it, at least");
        table.row([left, thousands(self.spare_bytes()), thousands(self.least_spare_bytes)]);
        table
    }
}

/// `NAME (rx) : ORIGIN = 0x…, LENGTH = …K`
fn region(line: &str) -> Option<Region> {
    let (name, rest) = line.split_once(": ORIGIN = 0x")?;
    let (address, length) = rest.split_once(", LENGTH = ")?;
    let name = name.split('(').next()?.trim().to_owned();
    let kilobytes: u64 = length.split('K').next()?.trim().parse().ok()?;
    let address = u64::from_str_radix(address.trim(), 16).ok()?;
    Some(Region { name, address, bytes: kilobytes * 1024, used_bytes: 0 })
}
