//! The message RAM that both FDCANs share: 10 KB at 0x4000_AC00 (RM0433, message RAM), and the elements in it.
//!
//! Where what lies is the software's to set: each instance has its start addresses, in words from the start of the
//! RAM, in SIDFC, XIDFC, RXFxC, RXBC, TXEFC and TXBC.

use std::sync::{Arc, Mutex};

use rigless::device::{DeviceContext as Context, ErasedDevice, RegisterFile, RequestChange};
use rigless::soc::{RegisterSpec, Width};
use rigless::time::{EventId, VirtualNanos};
use slipsense_can_sim::{Format, Frame, Id, len_of};

use crate::shared::lock;

pub const BASE: u64 = 0x4000_AC00;
/// Words of 32 bits.
pub const WORDS: usize = 2560;

/// The words, shared by the window that software writes through and the two instances.
#[derive(Clone, Debug)]
pub struct MessageRam(Arc<Mutex<Vec<u32>>>);

impl Default for MessageRam {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(vec![0; WORDS])))
    }
}

impl MessageRam {
    /// `None` beyond the end of the RAM.
    pub fn read(&self, word: usize) -> Option<u32> {
        lock(&self.0).get(word).copied()
    }

    /// Nothing beyond the end of the RAM.
    pub fn write(&self, word: usize, value: u32) {
        if let Some(slot) = lock(&self.0).get_mut(word) {
            *slot = value;
        }
    }
}

/// The RAM in its window of the part's addresses. The emulator's check of the wiring wants the very table that the bus
/// gave the window, which has no registers.
#[derive(Debug)]
pub struct RamWindow {
    pub ram: MessageRam,
    pub table: &'static [RegisterSpec],
}

impl ErasedDevice for RamWindow {
    fn layout(&self) -> &'static [RegisterSpec] {
        self.table
    }

    fn read_window(&mut self, offset: u64, width: Width, context: &mut Context<'_>) -> u64 {
        self.peek_window(offset, width, context.now()).unwrap_or(0)
    }

    fn write_window(&mut self, offset: u64, width: Width, value: u64, context: &mut Context<'_>) {
        if width != Width::W32 {
            // The RAM has no byte enables (RM0433: word access only); the silicon writes the whole word.
            context
                .tell("RAM", "the message RAM takes words only, and a narrower write spoils its neighbours");
        }
        self.ram.write(offset as usize / 4, value as u32);
    }

    fn peek_window(&self, offset: u64, width: Width, _now: VirtualNanos) -> Option<u64> {
        let word = self.ram.read(offset as usize / 4)?;
        Some(u64::from(word) >> (8 * (offset % 4)) & width.mask())
    }

    // There is no register, event, request or clock; a reset of the part leaves the words as they are.
    fn read(&mut self, _: usize, _: &mut RegisterFile, _: &mut Context<'_>) -> Option<u64> {
        None
    }
    fn write(&mut self, _: usize, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn on_event(&mut self, _: EventId, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn on_request(&mut self, _: RequestChange, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn on_clock(&mut self, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn poll(&mut self, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn reset(&mut self) {}
    fn on_access(&mut self, _: u64, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}
    fn on_refused(&mut self, _: u64, _: &mut RegisterFile, _: &mut Context<'_>) {}
}

const XTD: u32 = 1 << 30;
const RTR: u32 = 1 << 29;
const ESI: u32 = 1 << 31;
const FDF: u32 = 1 << 21;
const BRS: u32 = 1 << 20;
/// EFC of a Tx element: store a Tx event.
pub const TX_EVENT: u32 = 1 << 23;

/// An element: its first word, and how many bytes of data it holds.
#[derive(Clone, Copy, Debug)]
pub struct Element {
    pub word: usize,
    bytes: usize,
}

impl Element {
    /// Element `nth` of those from the word `start` on, whose size is TXESC.TBDS or RXESC.FxDS, the lowest bits of `size`.
    pub const fn nth(nth: usize, start: usize, size: u64) -> Self {
        let bytes = [8, 12, 16, 20, 24, 32, 48, 64][(size & 7) as usize];
        Self { word: start + nth * (2 + bytes / 4), bytes }
    }

    /// A Tx element as software wrote it, and what the FDCAN makes of it: FDF counts with CCCR.FDOE only, BRS with
    /// CCCR.BRSE (RM0433, Tx buffer element). A DLC beyond the element's size sends 0xCC for the rest.
    pub fn read_tx(self, ram: &MessageRam, fd: bool, switch: bool, passive: bool) -> Option<Frame> {
        let Self { word, bytes } = self;
        let (t0, t1) = (ram.read(word)?, ram.read(word + 1)?);
        let id = if t0 & XTD != 0 {
            Id::Extended(t0 & 0x1FFF_FFFF)
        } else {
            Id::Standard((t0 >> 18 & 0x7FF) as u16)
        };
        let format = if t1 & FDF != 0 && fd {
            Format::Fd { bit_rate_switch: t1 & BRS != 0 && switch, error_passive: t0 & ESI != 0 || passive }
        } else if t0 & RTR != 0 {
            Format::Remote
        } else {
            Format::Classic
        };
        let mut frame = Frame::with_dlc(id, format, (t1 >> 16 & 0xF) as u8).ok()?;
        for (index, byte) in frame.data_mut().iter_mut().enumerate() {
            *byte = match index < bytes {
                true => (ram.read(word + 2 + index / 4)? >> (8 * (index % 4))) as u8,
                false => 0xCC,
            };
        }
        Some(frame)
    }

    /// Writes an Rx element; data beyond its size is dropped (RXESC), and what is beyond the end of the RAM.
    pub fn write_rx(self, ram: &MessageRam, frame: &Frame, matched: Option<u8>, timestamp: u16) {
        let id = match frame.id() {
            Id::Standard(id) => u32::from(id) << 18,
            Id::Extended(id) => XTD | id,
        };
        let kind = match frame.format() {
            Format::Remote => RTR,
            Format::Fd { error_passive: true, .. } => ESI,
            _ => 0,
        };
        // ANMF: accepted although no filter matched.
        let filter = matched.map_or(1 << 31, |index| u32::from(index) << 24);
        let fd = if frame.format().is_fd() { FDF } else { 0 };
        let switch = if frame.format().switches() { BRS } else { 0 };
        let second = filter | fd | switch | u32::from(frame.dlc()) << 16 | u32::from(timestamp);
        ram.write(self.word, id | kind);
        ram.write(self.word + 1, second);
        let len = frame.data().len().min(len_of(frame.dlc(), true)).min(self.bytes);
        for (index, four) in frame.data()[..len].chunks(4).enumerate() {
            let value = four.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte));
            ram.write(self.word + 2 + index, value);
        }
    }
}
