//! The far end of the bus as a stream of bytes, for a program that is a node: `tests/python/can_link.py` and whatever
//! is behind it. A frame is 4 bytes of identifier, 1 of length, the data; low byte first.
//!
//! What the program sends goes on the wires at the next virtual millisecond and competes there as any node's frames
//! do. An identifier that no frame can have, [`SUPPLY`], is no frame: at which steps of the flash the board's supply
//! fails; [`ORDER`]: text, what else goes wrong there ([`crate::board_faults`]). What the board sends it gets, but for slip and raw messages: nothing behind the link could keep up with them.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};

use anyhow::{Context, Result, anyhow, ensure};
use slipsense::wire::{RAW_PORT, SLIP_PORT};
use slipsense_can_sim::{Format, Frame, Id};

use crate::fdcan::wire::{Wire, can_frame};

/// Bytes before the data: identifier and length.
const HEADER: usize = 5;
/// Before steps of eight bytes, lowest first.
const SUPPLY: u32 = 1 << 31;
/// Before a text.
const ORDER: u32 = SUPPLY | 1;

pub struct FarEnd {
    stream: TcpStream,
    pending: Vec<u8>,
    /// Entries of the wires' log that have been looked at.
    seen: usize,
    /// What the program wants of the supply: see [`PowerFaults::fail_at`](crate::power_faults::PowerFaults::fail_at).
    pub power_fails_at: Option<Vec<u64>>,
    /// What it wants of the board: see [`BoardFaults::order`](crate::board_faults::BoardFaults::order).
    pub orders: Vec<String>,
}

impl FarEnd {
    /// Print a port of this computer and wait for somebody there.
    pub fn wait() -> Result<Self> {
        let listener = TcpListener::bind("127.0.0.1:0").context("no port for the far end")?;
        println!("{}", listener.local_addr()?.port());
        let (stream, _) = listener.accept()?;
        stream.set_nodelay(true)?;
        Ok(Self { stream, pending: Vec::new(), seen: 0, power_fails_at: None, orders: Vec::new() })
    }

    /// Carry frames both ways. `false`: the program is gone.
    pub fn exchange(&mut self, now_ns: u64, wire: &mut Wire) -> Result<bool> {
        self.stream.set_nonblocking(true)?;
        let mut buffer = [0; 4096];
        match self.stream.read(&mut buffer) {
            Ok(0) => return Ok(false),
            Ok(length) => self.pending.extend(&buffer[..length]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => return Err(error).context("reading from the far end"),
        }
        while let Some((identifier, data)) = self.take_record() {
            match identifier {
                SUPPLY => {
                    let (steps, rest) = data.as_chunks();
                    ensure!(rest.is_empty(), "the far end says half a step of the flash");
                    self.power_fails_at = Some(steps.iter().map(|&step| u64::from_le_bytes(step)).collect());
                }
                ORDER => self.orders.push(String::from_utf8(data).context("the far end's order")?),
                _ => {
                    let frame = Frame::new(Id::Extended(identifier), Format::FD, &data);
                    let no_frame = |error| anyhow!("the far end sent no CAN FD frame: {error:?}");
                    wire.peer_queue.push_back((now_ns, frame.map_err(no_frame)?));
                }
            }
        }
        self.stream.set_nonblocking(false)?;
        let mut records = Vec::new();
        for logged in wire.log.iter().skip(self.seen).filter(|logged| logged.is_of_board()) {
            let Some(frame) = can_frame(&logged.frame) else { continue };
            if !matches!(logged.port(), Some(SLIP_PORT | RAW_PORT)) {
                records.extend(frame.id().to_le_bytes());
                records.push(frame.data().len() as u8);
                records.extend(frame.data());
            }
        }
        self.seen = wire.log.len();
        match self.stream.write_all(&records) {
            Ok(()) => Ok(true),
            Err(error) if error.kind() == ErrorKind::BrokenPipe => Ok(false),
            Err(error) => Err(error).context("writing to the far end"),
        }
    }

    fn take_record(&mut self) -> Option<(u32, Vec<u8>)> {
        let &[a, b, c, d, length] = self.pending.first_chunk::<HEADER>()?;
        let end = HEADER + usize::from(length);
        let data = self.pending.get(HEADER..end)?.to_vec();
        self.pending.drain(..end);
        Some((u32::from_le_bytes([a, b, c, d]), data))
    }
}
