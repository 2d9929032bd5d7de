//! The supply, which fails at a step of the flash: while a word is programmed or a sector erased.
//!
//! A step that was cut off is half done: the first half of the word's bytes, or of the sector's words, are as they
//! should become, the others as they were. What the silicon would add, a word that error correction gives up on and a
//! bus fault when it is read (RM0433, embedded flash memory), the emulator does not have. RAM keeps what it held. The
//! reset is a brown-out's.

use std::collections::VecDeque;

use anyhow::{Result, ensure};
use rigless::emulator::{Access, AccessKind, Host};
use rigless::session::Session;
use rigless::soc::Width;
use slipsense::update::partitions::{FLASH_BASE, SECTOR_BYTES};

use crate::machine::Twin;

/// FLASH_CR1 and FLASH_CR2 (RM0433, FLASH registers): SNB in bits 8 to 10, START bit 7, SER bit 2.
pub const CONTROL: [u64; 2] = [0x5200_200C, 0x5200_210C];
const START_AND_SECTOR: u64 = 1 << 7 | 1 << 2;
const BANK_BYTES: u64 = 1 << 20;
pub const FLASH: std::ops::Range<u64> = FLASH_BASE as u64..FLASH_BASE as u64 + 2 * BANK_BYTES;
const WORD: u64 = 32;
const PROGRAMS: &str = "the flash is a region that the part programs";

/// When it failed, at what.
#[derive(Clone, Debug)]
pub struct Failure {
    pub at_ns: u64,
    pub step: String,
}

#[derive(Debug, Default)]
pub struct PowerFaults {
    /// The steps at which it will fail, each counted from the one before.
    plan: VecDeque<u64>,
    /// Steps since then.
    done: u64,
    /// The word that is being handed over, piece by piece.
    word: Vec<(u64, Width, u64)>,
    pub failures: Vec<Failure>,
}

impl PowerFaults {
    /// Fail at these steps of the flash from now on, the first step being 1, each counted from the failure before. None
    /// calls off what is planned; other steps in its place are an error.
    pub fn fail_at(&mut self, steps: Vec<u64>) -> Result<()> {
        let planned = self.plan.len();
        ensure!(
            steps.is_empty() || planned == 0,
            "{planned} failures of the supply were planned and did not come"
        );
        self.plan = steps.into();
        self.done = 0;
        Ok(())
    }

    /// After each access of the core.
    pub fn look(&mut self, session: &mut Session<Twin>, host: &mut dyn Host, access: Access) {
        if access.kind != AccessKind::Write {
            return;
        }
        let bank = CONTROL.iter().position(|&control| control == access.address);
        let sector = bank.filter(|_| access.value & START_AND_SECTOR == START_AND_SECTOR).map(|bank| {
            FLASH.start + bank as u64 * BANK_BYTES + (access.value >> 8 & 7) * u64::from(SECTOR_BYTES)
        });
        if FLASH.contains(&access.address) {
            if access.address.is_multiple_of(WORD) {
                self.word.clear();
            }
            self.word.push((access.address, access.width, access.value));
            if !(access.address + u64::from(access.width.bytes())).is_multiple_of(WORD) {
                return;
            }
        } else if sector.is_none() {
            return;
        }
        self.done += 1;
        if self.plan.pop_front_if(|step| *step == self.done).is_none() {
            return;
        }
        self.done = 0;
        let step = if let Some(start) = sector {
            let half = start..start + u64::from(SECTOR_BYTES) / 2;
            half.step_by(8)
                .try_for_each(|address| host.program(address, Width::W64, u64::MAX))
                .expect(PROGRAMS);
            format!("the erase of {start:#010x}")
        } else {
            for &(address, width, value) in &self.word[..self.word.len() / 2] {
                let held = host.read(address, width).unwrap_or(0);
                host.program(address, width, held & value).expect(PROGRAMS);
            }
            format!("a word at {:#010x}", access.address / WORD * WORD)
        };
        self.failures.push(Failure { at_ns: access.virtual_time.0, step });
        session.board_mut().mcu.is_brown_out = true;
        session.reset_by_pin(access.virtual_time, access.instruction_count, host);
    }
}
