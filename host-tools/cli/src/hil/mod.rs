//! Hardware in the loop: an episode into the memory of a board, frame by frame, and every CAN frame of its answers
//! beside what this computer's pipeline sends.
//!
//! [`replay`] talks to the program `slipsense-hil` through its [`mailbox`](slipsense::board::mailbox), over a
//! [`Target`]: a GDB server ([`gdb`]), which debuggers, emulators and probes of every maker have, or a probe on USB.

pub mod gdb;
#[cfg(feature = "hil")]
pub mod probe;
pub mod replay;

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result};
use object::{Object, ObjectSymbol};
use slipsense::board::mailbox::SYMBOL;

/// A core whose memory can be read and written.
pub trait Target {
    /// Reset it, and hold it before its first instruction.
    fn reset(&mut self) -> Result<()>;

    /// Let it run for about so long. Whether it runs on after that is the target's business.
    fn run_for(&mut self, time: Duration) -> Result<()>;

    /// Read words from an address that is a multiple of four.
    fn read(&mut self, address: u32, words: &mut [u32]) -> Result<()>;

    /// Write words to an address that is a multiple of four.
    fn write(&mut self, address: u32, words: &[u32]) -> Result<()>;
}

/// Address of the mailbox in the ELF at `path`, the program that a board runs.
pub fn mailbox(path: &Path) -> Result<u32> {
    let name = path.display();
    let bytes = std::fs::read(path).with_context(|| format!("{name}: cannot read the program"))?;
    let elf = object::File::parse(&*bytes).with_context(|| format!("{name}: not an ELF file"))?;
    let symbol = elf.symbols().find(|symbol| symbol.name() == Ok(SYMBOL)).with_context(|| {
        format!("{name}: has no {SYMBOL}, so it is not slipsense-hil, which `cargo build-hil-h743` builds")
    })?;
    u32::try_from(symbol.address())
        .ok()
        .filter(|address| address.is_multiple_of(4))
        .with_context(|| format!("{name}: {SYMBOL} is at {:#x}, not in a core's memory", symbol.address()))
}
