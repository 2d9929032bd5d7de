//! What lies where in the flash: the one table, which the build script turns into the symbols of `partitions.x`, for
//! the linker to check its memory maps by.
//!
//! Addresses are offsets from the first byte of flash. An erase takes whole sectors; on the STM32H743 it stalls code
//! that runs from the same bank, so that everything that is written while the fingertips sense lies in bank 2, from
//! 0x10_0000 on. Half of bank 1 stays free: the slot for a new firmware must be one sector larger than the one it is
//! swapped with, and bank 2 has no room for more.

/// First address of flash.
pub const FLASH_BASE: u32 = 0x0800_0000;
/// Erased as one.
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

/// The flash of a board. Every partition is whole sectors, and none reaches into another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Partitions {
    /// What an image names the board by.
    pub id: u16,
    /// As on the label.
    pub label: &'static str,
    /// The bootloader.
    pub boot: Span,
    /// The firmware that runs, linked to run here.
    pub active: Span,
    /// Where a new firmware is put together, and the one before is kept until the new one has confirmed.
    pub dfu: Span,
    /// How far embassy-boot is.
    pub state: Span,
    /// A model that is taken in place of the one in the firmware.
    pub model: Span,
    /// Settings.
    pub settings: Span,
    /// All of it.
    pub flash: Span,
}

/// The board that there is firmware for.
pub const NUCLEO_H743ZI2: Partitions = Partitions {
    id: 1,
    label: "NUCLEO-H743ZI2",
    boot: Span::sectors(0, 1),
    active: Span::sectors(1, 3),
    dfu: Span::sectors(8, 4),
    state: Span::sectors(12, 1),
    model: Span::sectors(13, 1),
    settings: Span::sectors(14, 2),
    flash: Span::sectors(0, 16),
};

impl Partitions {
    /// What the firmware itself erases and writes: settings and updates, which lie together.
    pub const fn written(&self) -> Span {
        self.dfu.with(self.state).with(self.model).with(self.settings)
    }

    /// Every partition, by name.
    pub const fn named(&self) -> [(&'static str, Span); 6] {
        [
            ("boot", self.boot),
            ("active", self.active),
            ("dfu", self.dfu),
            ("state", self.state),
            ("model", self.model),
            ("settings", self.settings),
        ]
    }
}
