//! The program that a board runs, as far as the host needs to know it.

use std::path::Path;

use anyhow::{Context, Result, bail};
use object::{Object, ObjectSymbol};
use slipsense::board::mailbox::SYMBOL;

/// Address of the mailbox in the ELF at `path`.
pub fn mailbox(path: &Path) -> Result<u32> {
    let name = path.display();
    let bytes = std::fs::read(path).with_context(|| format!("{name}: cannot read the program"))?;
    let elf = object::File::parse(&*bytes).with_context(|| format!("{name}: not an ELF file"))?;
    let Some(symbol) = elf.symbols().find(|symbol| symbol.name() == Ok(SYMBOL)) else {
        bail!("{name}: has no {SYMBOL}, so it is not slipsense-hil, which `cargo build-hil-h743` builds");
    };
    u32::try_from(symbol.address())
        .ok()
        .filter(|address| address.is_multiple_of(4))
        .with_context(|| format!("{name}: {SYMBOL} is at {:#x}, not in a core's memory", symbol.address()))
}
