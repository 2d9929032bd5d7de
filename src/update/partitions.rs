//! What lies where in the flash: the one table, by which the linker checks the memory maps of firmware and bootloader.
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
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Partitions {
    /// What an image names the board by.
    pub id: u16,
    /// As on the label.
    pub label: &'static str,
    pub boot: Span,
    /// The firmware that runs, linked to run here.
    pub active: Span,
    /// Where a new firmware is put together, and the one before is kept until the new one has confirmed.
    pub dfu: Span,
    /// How far embassy-boot is.
    pub state: Span,
    /// A model that is taken in place of the one in the firmware.
    pub model: Span,
    pub settings: Span,
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
}

const _: () = {
    let Partitions { boot, active, dfu, state, model, settings, flash, .. } = NUCLEO_H743ZI2;
    let spans = [boot, active, dfu, state, model, settings, Span { start: flash.end, end: flash.end }];
    let mut index = 1;
    while index < spans.len() {
        assert!(
            spans[index - 1].end <= spans[index].start,
            "a partition reaches into the next, or leaves the flash"
        );
        index += 1;
    }
    assert!(active.end <= NUCLEO_H743ZI2.written().start, "no program lies in what the firmware writes");
    assert!(dfu.bytes() == active.bytes() + SECTOR_BYTES, "embassy-boot's swap needs one sector more");
};
