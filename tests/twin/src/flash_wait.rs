//! The bootloader waits for the flash by asking it over and over, seconds for an erase, which is most of the work that a
//! swap gives the emulator. Instead the core is held until the flash is ready: time passes, and what the bootloader then
//! finds is the same. The firmware waits by interrupts and is left alone.

use rigless::emulator::{Access, AccessKind, Host};
use rigless::mcu::Operate;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::machine::Twin;
use crate::programs::{BOARD, addresses};

/// FLASH_SR1 and FLASH_SR2 (RM0433, FLASH registers): BSY in bit 0, QW in bit 2.
const STATUS: [u64; 2] = [0x5200_2010, 0x5200_2110];
const BUSY: u64 = 1 << 0 | 1 << 2;

/// The bank that the core waits for.
#[derive(Debug, Default)]
pub struct FlashWait {
    status: Option<u64>,
}

impl FlashWait {
    /// After each access of the core, and what was read.
    pub fn look(&mut self, host: &mut dyn Host, access: Access, value: u64) {
        let boots = access.program_counter.is_some_and(|at| addresses(BOARD.boot).contains(&at));
        let asks = access.kind == AccessKind::Read && STATUS.contains(&access.address);
        if boots && asks && value & BUSY != 0 {
            self.status = Some(access.address);
            host.hold(true);
        }
    }

    pub fn settle(&mut self, session: &mut Session<Twin>, host: &mut dyn Host, now: VirtualNanos) {
        let Some(status) = self.status else { return };
        // A status that nothing answers for is none to wait for.
        if session.mcu().peek(now, status, Width::W32).is_ok_and(|value| value & BUSY != 0) {
            return;
        }
        self.status = None;
        host.hold(false);
    }
}
