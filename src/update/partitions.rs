//! What lies where in the flash of each board: the one table, which the build script turns into the symbols and
//! checks of `partitions.x` for the linker.
//!
//! Addresses are offsets from the first byte of flash. An erase takes whole sectors; on the STM32H743 it stalls code
//! that runs from the same bank, so that everything that is written while the fingertips sense lies in bank 2, from
//! 0x10_0000 on. Half of bank 1 stays free: the slot for a new firmware must be one sector larger than the one it is
//! swapped with, and bank 2 has no room for more.
//!
//! **The STM32H723ZG has no room for a second firmware.** Of its eight sectors settings take two and a bootloader one.
//! Five are left, which is a slot of two and one of three for embassy-boot's swap: 256 KB, less than firmware with
//! model and services. It takes models over the bus, and its firmware from a debug probe.

/// First address of flash, both boards.
pub const FLASH_BASE: u32 = 0x0800_0000;
/// Erased as one, both boards.
pub const SECTOR_BYTES: u32 = 128 * 1024;
/// At the end of a slot of a firmware, what says that it is whole. All that a slot holds is shorter by this.
pub const TRAILER_BYTES: u32 = 1024;

/// A stretch of flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Span {
    /// Its first byte.
    pub start: u32,
    /// Behind its last byte.
    pub end: u32,
}

impl Span {
    const fn sectors(first: u32, count: u32) -> Self {
        Self { start: first * SECTOR_BYTES, end: (first + count) * SECTOR_BYTES }
    }

    /// From the first byte of both to the last.
    const fn with(self, other: Self) -> Self {
        Self {
            start: if other.start < self.start { other.start } else { self.start },
            end: if other.end > self.end { other.end } else { self.end },
        }
    }

    /// How long it is.
    pub const fn bytes(self) -> u32 {
        self.end - self.start
    }
}

/// What an update of the firmware over the bus needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Swap {
    /// The bootloader.
    pub boot: Span,
    /// Where a new firmware is put together, and the one before is kept until the new one has confirmed.
    pub dfu: Span,
    /// How far embassy-boot is.
    pub state: Span,
}

/// The flash of a board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Partitions {
    /// The board's feature of the package, and its folder in `src/board`.
    pub feature: &'static str,
    /// What an image names the board by.
    pub id: u16,
    /// As on the label.
    pub label: &'static str,
    /// The firmware that runs, linked to run here.
    pub active: Span,
    /// `None`: no room for a second firmware.
    pub swap: Option<Swap>,
    /// A model that is taken in place of the one in the firmware.
    pub model: Span,
    /// Settings.
    pub settings: Span,
    /// All of it.
    pub flash: Span,
}

/// Every board.
pub const BOARDS: [Partitions; 2] = [
    Partitions {
        feature: "h743",
        id: 1,
        label: "NUCLEO-H743ZI2",
        active: Span::sectors(1, 3),
        swap: Some(Swap { boot: Span::sectors(0, 1), dfu: Span::sectors(8, 4), state: Span::sectors(12, 1) }),
        model: Span::sectors(13, 1),
        settings: Span::sectors(14, 2),
        flash: Span::sectors(0, 16),
    },
    Partitions {
        feature: "h723",
        id: 2,
        label: "NUCLEO-H723ZG",
        active: Span::sectors(0, 5),
        swap: None,
        model: Span::sectors(7, 1),
        settings: Span::sectors(5, 2),
        flash: Span::sectors(0, 8),
    },
];

/// The board of this feature.
pub const fn by_feature(feature: &str) -> Option<&'static Partitions> {
    const TABLE: &[Partitions] = &BOARDS;
    let mut index = 0;
    while index < TABLE.len() {
        if same(TABLE[index].feature.as_bytes(), feature.as_bytes()) {
            return Some(&TABLE[index]);
        }
        index += 1;
    }
    None
}

const fn same(a: &[u8], b: &[u8]) -> bool {
    let mut index = 0;
    while index < a.len() && index < b.len() && a[index] == b[index] {
        index += 1;
    }
    index == a.len() && index == b.len()
}

impl Partitions {
    /// What the firmware itself erases and writes: settings and updates, which lie together.
    pub const fn written(&self) -> Span {
        let mut span = self.settings;
        span = span.with(self.model);
        if let Some(swap) = self.swap {
            span = span.with(swap.dfu).with(swap.state);
        }
        span
    }

    /// Every partition, by name.
    pub fn named(&self) -> impl Iterator<Item = (&'static str, Span)> {
        let swap = self.swap.map(|swap| [("boot", swap.boot), ("dfu", swap.dfu), ("state", swap.state)]);
        let always = [("active", self.active), ("model", self.model), ("settings", self.settings)];
        always.into_iter().chain(swap.into_iter().flatten())
    }
}
