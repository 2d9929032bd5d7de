//! Acceptance filtering: RM0433, acceptance filter, and the filter elements of the message RAM.

use rigless::soc::stm32h743::generated::fdcan1::Register;
use slipsense_can_sim::{Format, Frame, Id};

use super::Fdcan;
use super::registers::{gfc, sidfc, xidfc};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Accepted {
    Rejected,
    /// FIFO 0 or 1, and the index of the filter that matched, or none.
    Fifo(usize, Option<u8>),
    /// A dedicated Rx buffer.
    Buffer,
}

/// What a filter element's SFEC/EFEC says.
fn configured(code: u32, index: u8) -> Option<Accepted> {
    match code {
        1 | 5 => Some(Accepted::Fifo(0, Some(index))),
        2 | 6 => Some(Accepted::Fifo(1, Some(index))),
        // 4: priority only, stored nowhere, and filtering ends.
        3 | 4 => Some(Accepted::Rejected),
        7 => Some(Accepted::Buffer),
        // Disabled.
        _ => None,
    }
}

/// SFT/EFT: range, two identifiers, filter and mask.
fn matches(kind: u32, id: u32, id1: u32, id2: u32) -> bool {
    match kind {
        0 => (id1..=id2).contains(&id),
        1 => id == id1 || id == id2,
        2 => id & id2 == id1 & id2,
        _ => false,
    }
}

impl Fdcan {
    /// Runs a frame through the filters that the registers and the message RAM describe.
    pub(super) fn accept(&self, frame: &Frame) -> Accepted {
        let global = self.get(Register::FdcanGfc);
        let remote = frame.format() == Format::Remote;
        let (found, reject_remote, unmatched) = match frame.id() {
            Id::Standard(id) => {
                let sidfc = self.get(Register::FdcanSidfc);
                let start = sidfc::FLSSA.get(sidfc) as usize;
                let found = (0..sidfc::LSS.get(sidfc).min(128) as usize).find_map(|index| {
                    let word = self.ram.read(start + index)?;
                    let (id1, id2, code) = (word >> 16 & 0x7FF, word & 0x7FF, word >> 27 & 7);
                    // A dedicated buffer's element matches SFID1 exactly.
                    let hit = if code == 7 {
                        u32::from(id) == id1
                    } else {
                        matches(word >> 30, id.into(), id1, id2)
                    };
                    if hit { configured(code, index as u8) } else { None }
                });
                (found, gfc::RRFS.is_set(global), gfc::ANFS.get(global))
            }
            Id::Extended(id) => {
                let xidfc = self.get(Register::FdcanXidfc);
                let start = xidfc::FLESA.get(xidfc) as usize;
                let mask = self.get(Register::FdcanXidam) as u32;
                let found = (0..xidfc::LSE.get(xidfc).min(64) as usize).find_map(|index| {
                    let (f0, f1) = (self.ram.read(start + 2 * index)?, self.ram.read(start + 2 * index + 1)?);
                    let (id1, id2, code, kind) = (f0 & 0x1FFF_FFFF, f1 & 0x1FFF_FFFF, f0 >> 29, f1 >> 30);
                    let hit = match (code, kind) {
                        (7, _) => id & mask == id1,
                        // Range without XIDAM.
                        (_, 3) => (id1..=id2).contains(&id),
                        _ => matches(kind, id & mask, id1, id2),
                    };
                    if hit { configured(code, index as u8) } else { None }
                });
                (found, gfc::RRFE.is_set(global), gfc::ANFE.get(global))
            }
        };
        if remote && reject_remote {
            return Accepted::Rejected;
        }
        found.unwrap_or(match unmatched {
            0 => Accepted::Fifo(0, None),
            1 => Accepted::Fifo(1, None),
            _ => Accepted::Rejected,
        })
    }
}
