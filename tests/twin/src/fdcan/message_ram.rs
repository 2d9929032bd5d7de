//! The message RAM that both FDCANs share: 10 KB at 0x4000_AC00 (RM0433, message RAM), and the elements in it.
//!
//! Where what lies is the software's to set: each instance has its start addresses, in words from the start of the
//! RAM, in SIDFC, XIDFC, RXFxC, RXBC, TXEFC and TXBC.

use std::sync::{Arc, Mutex, MutexGuard};

use rigless::chip::parallel::Peer;
use rigless::device::DeviceContext as Context;
use rigless::snapshot::Store;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use slipsense_can_sim::{Format, Frame, Id, len_of};

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
    fn words(&self) -> MutexGuard<'_, Vec<u32>> {
        self.0.lock().expect("no holder of the message RAM panics")
    }

    /// `None` beyond the end of the RAM.
    pub fn read(&self, word: usize) -> Option<u32> {
        self.words().get(word).copied()
    }

    /// `false` beyond the end of the RAM.
    pub fn write(&self, word: usize, value: u32) -> bool {
        self.words().get_mut(word).map(|slot| *slot = value).is_some()
    }
}

impl Store for MessageRam {}

impl Peer for MessageRam {
    fn read(&mut self, offset: u64, width: Width, _context: &mut Context<'_>) -> u64 {
        let word = MessageRam::read(self, offset as usize / 4).unwrap_or(0);
        u64::from(word) >> (8 * (offset % 4)) & width.mask()
    }

    fn write(&mut self, offset: u64, width: Width, value: u64, context: &mut Context<'_>) {
        if width != Width::W32 {
            // The RAM has no byte enables (RM0433: word access only); the silicon writes the whole word.
            context
                .tell("RAM", "the message RAM takes words only, and a narrower write spoils its neighbours");
        }
        MessageRam::write(self, offset as usize / 4, value as u32);
    }

    fn peek(&self, offset: u64, width: Width, _now: VirtualNanos) -> Option<u64> {
        let word = MessageRam::read(self, offset as usize / 4)?;
        Some(u64::from(word) >> (8 * (offset % 4)) & width.mask())
    }
}

const XTD: u32 = 1 << 30;
const RTR: u32 = 1 << 29;
const ESI: u32 = 1 << 31;
const FDF: u32 = 1 << 21;
const BRS: u32 = 1 << 20;
/// EFC of a Tx element: store a Tx event.
pub const TX_EVENT: u32 = 1 << 23;

/// Bytes of data that an element holds, by TXESC.TBDS and RXESC.FxDS.
pub const fn element_bytes(code: u64) -> usize {
    [8, 12, 16, 20, 24, 32, 48, 64][(code & 7) as usize]
}

pub const fn element_words(bytes: usize) -> usize {
    2 + bytes / 4
}

/// A Tx element as software wrote it at `word`, and what the FDCAN makes of it: FDF counts with CCCR.FDOE only, BRS with
/// CCCR.BRSE (RM0433, Tx buffer element). A DLC beyond the element's size sends 0xCC for the rest.
pub fn read_tx(
    ram: &MessageRam,
    word: usize,
    bytes: usize,
    fd: bool,
    switch: bool,
    passive: bool,
) -> Option<Frame> {
    let (t0, t1) = (ram.read(word)?, ram.read(word + 1)?);
    let id =
        if t0 & XTD != 0 { Id::Extended(t0 & 0x1FFF_FFFF) } else { Id::Standard((t0 >> 18 & 0x7FF) as u16) };
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

/// Writes an Rx element at `word`; data beyond `bytes` is dropped (RXESC). `false` beyond the RAM.
pub fn write_rx(
    ram: &MessageRam,
    word: usize,
    bytes: usize,
    frame: &Frame,
    matched: Option<u8>,
    timestamp: u16,
) -> bool {
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
    let mut good = ram.write(word, id | kind) && ram.write(word + 1, second);
    let len = frame.data().len().min(len_of(frame.dlc(), true)).min(bytes);
    for (index, four) in frame.data()[..len].chunks(4).enumerate() {
        let value = four.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte));
        good &= ram.write(word + 2 + index, value);
    }
    good
}
