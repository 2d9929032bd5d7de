//! Register access over SPI through one buffer: an address byte and data in one transfer, in place, because a board
//! that moves bytes by DMA may only name memory that its DMA reaches. The board chooses where the buffer lies.

use embedded_hal_async::spi::{Error, SpiDevice};

use crate::board::XlFault;

/// Longest transfer: an address and the whole FIFO of an ICM-42688-P, 2048 bytes, rounded up to a cache line.
pub const SPI_BUFFER_BYTES: usize = 2080;
/// Where the bytes of a transfer lie, out and in.
pub type SpiBuffer = [u8; SPI_BUFFER_BYTES];

/// An SPI device and its buffer.
#[derive(Debug)]
pub struct Registers<'b, SPI> {
    spi: SPI,
    buffer: &'b mut SpiBuffer,
}

impl<'b, SPI: SpiDevice> Registers<'b, SPI> {
    pub const fn new(spi: SPI, buffer: &'b mut SpiBuffer) -> Self {
        Self { spi, buffer }
    }

    /// Send `command`, then read `length` bytes; at most what the buffer holds.
    pub async fn read(&mut self, command: u8, length: usize) -> Result<&[u8], XlFault> {
        let end = (1 + length).min(SPI_BUFFER_BYTES);
        let bytes = self.buffer.get_mut(..end).unwrap_or_default();
        bytes.fill(0);
        if let Some(first) = bytes.first_mut() {
            *first = command;
        }
        self.spi.transfer_in_place(bytes).await.map_err(|error| XlFault::Bus(error.kind()))?;
        Ok(bytes.get(1..).unwrap_or_default())
    }

    /// Write `register` and see that it keeps the value; `commands`: how it is written, how it is read.
    pub async fn set(&mut self, register: u8, commands: [u8; 2], value: u8) -> Result<(), XlFault> {
        let [write, read] = commands;
        self.write(write, value).await?;
        if self.read(read, 1).await? == [value] { Ok(()) } else { Err(XlFault::Refused { register }) }
    }

    /// Send `command` and one byte.
    pub async fn write(&mut self, command: u8, value: u8) -> Result<(), XlFault> {
        // It is longer.
        let Some(bytes) = self.buffer.first_chunk_mut::<2>() else { return Ok(()) };
        *bytes = [command, value];
        self.spi.transfer_in_place(bytes).await.map_err(|error| XlFault::Bus(error.kind()))
    }
}
