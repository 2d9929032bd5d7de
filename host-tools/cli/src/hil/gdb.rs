//! A core behind a GDB server: OpenOCD, probe-rs, J-Link, pyOCD, an emulator.
//!
//! Of the protocol ("Debugging with GDB", appendix E) the smallest part, which every server has: stop and go, memory,
//! and `monitor reset halt`. In all-stop mode a server reads no memory of a running core, so the core is stopped for
//! every look.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};

use super::Target;

/// Words of one packet: every server takes packets of 2 KB and a little.
const PACKET_WORDS: usize = 240;
const PACKET_BYTES_MAX: usize = 1 << 16;
/// What GDB sends to stop a core.
const INTERRUPT: u8 = 0x03;
/// Connecting takes no longer on a network that works.
const CONNECT: Duration = Duration::from_secs(5);

pub struct GdbServer {
    name: String,
    stream: TcpStream,
    timeout: Duration,
    received: Vec<u8>,
}

impl GdbServer {
    /// Connect to `HOST:PORT`. A server that says nothing for `timeout` is an error.
    pub fn connect(address: &str, timeout: Duration) -> Result<Self> {
        let addresses =
            address.to_socket_addrs().with_context(|| format!("--gdb {address}: not HOST:PORT"))?;
        let mut tries = addresses.map(|address| TcpStream::connect_timeout(&address, CONNECT));
        let first = tries.next().with_context(|| format!("--gdb {address}: no such host"))?;
        let stream = first.or_else(|error| tries.find_map(Result::ok).ok_or(error));
        let stream = stream.with_context(|| format!("--gdb {address}: nothing serves a debugger there"))?;
        stream.set_nodelay(true)?;
        let mut server = Self { name: format!("--gdb {address}"), stream, timeout, received: Vec::new() };
        // Why the core stands still; a server that lets it run stops it for a debugger.
        server.ask("?")?;
        Ok(server)
    }

    fn send(&mut self, packet: &str) -> Result<()> {
        let sum = packet.bytes().fold(0u8, u8::wrapping_add);
        let text = format!("${packet}#{sum:02x}");
        self.stream.write_all(text.as_bytes()).with_context(|| format!("{}: the server is gone", self.name))
    }

    /// The next packet; `None` if none comes in that time.
    fn packet(&mut self, timeout: Duration) -> Result<Option<String>> {
        self.stream.set_read_timeout(Some(timeout))?;
        loop {
            if let Some(packet) = self.take_packet()? {
                return Ok(Some(packet));
            }
            let mut more = [0; 4096];
            match self.stream.read(&mut more) {
                Ok(0) => bail!("{}: the server has closed the connection", self.name),
                Ok(count) => self.received.extend_from_slice(&more[..count]),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return Ok(None);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return Err(error).with_context(|| self.name.clone()),
            }
        }
    }

    /// A whole packet off the front of what was received, acknowledged. What stands between packets is dropped.
    fn take_packet(&mut self) -> Result<Option<String>> {
        let Some(start) = self.received.iter().position(|&byte| byte == b'$') else {
            self.received.clear();
            return Ok(None);
        };
        self.received.drain(..start);
        let Some(end) = self.received.iter().position(|&byte| byte == b'#') else {
            ensure!(self.received.len() < PACKET_BYTES_MAX, "{}: a packet without an end", self.name);
            return Ok(None);
        };
        let Some(sum) = self.received.get(end + 1..end + 3) else { return Ok(None) };
        let sum = std::str::from_utf8(sum).ok().and_then(|sum| u8::from_str_radix(sum, 16).ok());
        let packet: Vec<u8> = self.received.drain(..end + 3).skip(1).take(end - 1).collect();
        let is_whole = sum == Some(packet.iter().copied().fold(0, u8::wrapping_add));
        ensure!(is_whole, "{}: a packet with a wrong checksum", self.name);
        self.stream.write_all(b"+").with_context(|| format!("{}: the server is gone", self.name))?;
        Ok(Some(String::from_utf8_lossy(&packet).into_owned()))
    }

    fn answer(&mut self, to: &str) -> Result<String> {
        match self.packet(self.timeout)? {
            Some(packet) => Ok(packet),
            None => bail!("{}: no answer to `{to}` for {} s", self.name, self.timeout.as_secs_f32()),
        }
    }

    fn ask(&mut self, packet: &str) -> Result<String> {
        self.send(packet)?;
        self.answer(packet.get(..20).unwrap_or(packet))
    }

    /// Does the packet say that the core has stopped? Others are output of the program, and what else comes unasked.
    fn stopped(&self, packet: &str) -> Result<bool> {
        ensure!(!packet.starts_with(['W', 'X']), "{}: what it debugs has ended", self.name);
        Ok(packet.starts_with(['S', 'T']))
    }
}

impl Target for GdbServer {
    fn reset(&mut self) -> Result<()> {
        let command: String = "reset halt".bytes().map(|byte| format!("{byte:02x}")).collect();
        let mut answer = self.ask(&format!("qRcmd,{command}"))?;
        // Text for the user's terminal, then OK.
        while answer.starts_with('O') && answer != "OK" {
            answer = self.answer("monitor reset halt")?;
        }
        let is_error = answer.is_empty() || answer.starts_with('E');
        ensure!(!is_error, "{}: the server refuses `monitor reset halt`: `{answer}`", self.name);
        Ok(())
    }

    fn run_for(&mut self, time: Duration) -> Result<()> {
        self.send("c")?;
        while let Some(packet) = self.packet(time)? {
            ensure!(!self.stopped(&packet)?, "{}: the core has stopped by itself: `{packet}`", self.name);
        }
        self.stream.write_all(&[INTERRUPT]).with_context(|| format!("{}: the server is gone", self.name))?;
        loop {
            let packet = self.answer("the interrupt")?;
            if self.stopped(&packet)? {
                return Ok(());
            }
        }
    }

    fn read(&mut self, address: u32, words: &mut [u32]) -> Result<()> {
        for (words, address) in words.chunks_mut(PACKET_WORDS).zip((address..).step_by(4 * PACKET_WORDS)) {
            let bytes = 4 * words.len() as u32;
            let answer = self.ask(&format!("m{address:x},{bytes:x}"))?;
            let values = (answer.len() == 2 * bytes as usize).then(|| from_hex(&answer)).flatten();
            let Some(values) = values else {
                bail!("{}: {bytes} bytes at {address:#010x} cannot be read: `{answer}`", self.name);
            };
            words.copy_from_slice(&values);
        }
        Ok(())
    }

    fn write(&mut self, address: u32, words: &[u32]) -> Result<()> {
        for (words, address) in words.chunks(PACKET_WORDS).zip((address..).step_by(4 * PACKET_WORDS)) {
            let bytes = 4 * words.len() as u32;
            let data: String = words.iter().map(|word| format!("{:08x}", word.swap_bytes())).collect();
            let answer = self.ask(&format!("M{address:x},{bytes:x}:{data}"))?;
            let is_written = answer == "OK";
            ensure!(is_written, "{}: {address:#010x} cannot be written: `{answer}`", self.name);
        }
        Ok(())
    }
}

/// Words as they lie in memory, lowest byte first.
fn from_hex(text: &str) -> Option<Vec<u32>> {
    let digits = text.as_bytes().chunks(8).map(|digits| std::str::from_utf8(digits).ok());
    digits.map(|digits| u32::from_str_radix(digits?, 16).ok().map(u32::swap_bytes)).collect()
}
