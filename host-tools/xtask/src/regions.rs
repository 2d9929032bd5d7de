//! What a firmware takes of each region of its board's memory map, and of 512 KB of flash.

use anyhow::{Context, Result, ensure};
use serde::Serialize;

use crate::board::Board;
use crate::elf::{Image, Kind};
use crate::root;
use crate::table::{Align, Table, thousands};

/// Code, constants, model and first contents of RAM: what an update carries, at most. `memory.x` asserts it too.
const FLASH_BYTES_MAX: u64 = 512 * 1024;

/// What has to be left of the region that code is linked to. The same source is 10 KB longer by one compiler than by
/// another, and CI has but one of those that users have; up to 8 KB lie unused before the code, because the image of
/// ITCM has a place of its own.
const FLASH_SPARE_BYTES: u64 = 20 * 1024;
/// That region.
const CODE: &str = "FLASH";

/// A region of `memory.x`.
#[derive(Clone, Debug, Serialize)]
pub struct Region {
    pub name: String,
    pub address: u64,
    pub bytes: u64,
    /// By sections that lie there when the program runs; none of the stack.
    pub used_bytes: u64,
}

/// One board's firmware.
#[derive(Clone, Debug, Serialize)]
pub struct Regions {
    pub board: Board,
    pub regions: Vec<Region>,
    /// Everything that is programmed into flash.
    pub flash_bytes: u64,
}

impl Regions {
    pub fn of(board: Board, image: &Image) -> Result<Self> {
        let path = root().join("src/firmware/bin/app/memory.x");
        let map =
            std::fs::read_to_string(&path).with_context(|| format!("{}: cannot read", path.display()))?;
        let mut regions: Vec<_> = map.lines().filter_map(region).collect();
        ensure!(!regions.is_empty(), "{}: no region found", path.display());
        for section in &image.sections {
            let holds = |region: &&mut Region| {
                (region.address..region.address + region.bytes).contains(&section.address)
            };
            let region = regions.iter_mut().find(holds);
            let region = region.with_context(|| format!("section {} lies in no region", section.name))?;
            region.used_bytes += section.bytes;
        }
        let flash = image.sections.iter().filter(|section| section.kind != Kind::Zeroed);
        Ok(Self { board, regions, flash_bytes: flash.map(|section| section.bytes).sum() })
    }

    pub fn fits(&self) -> bool {
        self.flash_bytes <= FLASH_BYTES_MAX
            && self.spare_bytes() >= FLASH_SPARE_BYTES as i64
            && self.regions.iter().all(|r| r.used_bytes <= r.bytes)
    }

    /// What is left of the region of the code by all that is programmed.
    fn spare_bytes(&self) -> i64 {
        let code = self.regions.iter().find(|region| region.name == CODE);
        code.map_or(0, |region| region.bytes as i64) - self.flash_bytes as i64
    }

    pub fn table(&self) -> Table {
        let mut table = Table::new(
            format!("Memory of the firmware, bytes, the model included ({})", self.board.label()),
            &[("region", Align::Left), ("used", Align::Right), ("of", Align::Right)],
        );
        for Region { name, bytes, used_bytes, .. } in &self.regions {
            table.row([name.clone(), thousands(*used_bytes as i64), thousands(*bytes as i64)]);
        }
        let [used, most] = [self.flash_bytes, FLASH_BYTES_MAX].map(|bytes| thousands(bytes as i64));
        table.row(["all that is programmed".to_owned(), used, most]);
        let [spare, least] = [self.spare_bytes(), FLASH_SPARE_BYTES as i64].map(thousands);
        table.row([format!("left of {CODE} by it, at least"), spare, least]);
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
