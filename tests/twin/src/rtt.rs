//! The firmware's log: RTT's first up-channel read as a debug probe reads it, and defmt's frames in it.

use anyhow::{Result, anyhow};
use defmt_decoder::{DecodeError, Table};
use rigless::emulator::Memory;
use rigless::soc::Width;

/// Offset of the first up-channel in the control block, and of its fields.
const CHANNEL: u64 = 24;
const BUFFER: u64 = CHANNEL + 4;
const SIZE: u64 = CHANNEL + 8;
const WRITE: u64 = CHANNEL + 12;
const READ: u64 = CHANNEL + 16;

#[derive(Debug)]
pub struct Probe {
    /// Address of the control block.
    pub block: u64,
    pub bytes: Vec<u8>,
}

impl Probe {
    /// Empties the buffer. Nothing happens before the firmware has set it up.
    pub fn drain(&mut self, memory: &mut dyn Memory) {
        let [buffer, size, write, mut read] = [BUFFER, SIZE, WRITE, READ]
            .map(|offset| memory.read(self.block + offset, Width::W32).unwrap_or(0));
        if size == 0 || size > 1 << 20 || write >= size || read >= size {
            return;
        }
        while read != write {
            let Ok(byte) = memory.read(buffer + read, Width::W8) else { return };
            self.bytes.push(byte as u8);
            read = (read + 1) % size;
        }
        // A refused write would only make the firmware's buffer look full.
        let _ = memory.write(self.block + READ, Width::W32, read);
    }
}

pub fn lines(elf: &[u8], bytes: &[u8]) -> Result<Vec<String>> {
    let table = Table::parse(elf)?.ok_or_else(|| anyhow!("the firmware has no defmt section"))?;
    let mut decoder = table.new_stream_decoder();
    decoder.received(bytes);
    let mut lines = Vec::new();
    loop {
        match decoder.decode() {
            Ok(frame) => lines.push(frame.display(false).to_string()),
            Err(DecodeError::UnexpectedEof) => return Ok(lines),
            Err(DecodeError::Malformed) => lines.push("(a damaged line)".to_owned()),
        }
    }
}
