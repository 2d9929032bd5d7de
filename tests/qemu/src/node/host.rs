//! The node as a process: one client at a time, on a port that it prints.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use slipsense::wire::CanFrame;
use slipsense_qemu::link::{Decoder, RECORD_MAX, encode};
use slipsense_qemu::node_loop::{Link, serve};
use slipsense_qemu::ram_flash::FLASH_BYTES;

struct Socket {
    stream: TcpStream,
    decoder: Decoder,
    pending: Vec<u8>,
    start: Instant,
}

impl Link for Socket {
    fn receive(&mut self) -> Option<(CanFrame, u64)> {
        let mut buffer = [0; 4096];
        match self.stream.read(&mut buffer) {
            // The client is gone, and with it the reason to be.
            Ok(0) => std::process::exit(0),
            Ok(length) => self.pending.extend(&buffer[..length]),
            Err(error) if error.kind() == ErrorKind::WouldBlock => {}
            Err(error) => {
                eprintln!("error: reading from the client: {error}");
                std::process::exit(1);
            }
        }
        let now_us = self.now_us();
        for (index, &byte) in self.pending.iter().enumerate() {
            if let Some(frame) = self.decoder.accept(byte) {
                self.pending.drain(..=index);
                return Some((frame, now_us));
            }
        }
        self.pending.clear();
        None
    }

    fn send(&mut self, frame: &CanFrame) {
        let mut record = [0; RECORD_MAX];
        let length = encode(frame, &mut record);
        let mut rest = &record[..length];
        while !rest.is_empty() {
            match self.stream.write(rest) {
                Ok(written) => rest = &rest[written..],
                Err(error) if error.kind() == ErrorKind::WouldBlock => self.idle(),
                Err(error) => {
                    eprintln!("error: writing to the client: {error}");
                    std::process::exit(1);
                }
            }
        }
    }

    fn now_us(&self) -> u64 {
        self.start.elapsed().as_micros() as u64
    }

    fn idle(&mut self) {
        std::thread::sleep(Duration::from_micros(200));
    }
}

/// Wait for a client and serve it, through every restart.
pub fn run() -> std::io::Result<()> {
    let listener = TcpListener::bind("127.0.0.1:0")?;
    println!("{}", listener.local_addr()?.port());
    let (stream, _) = listener.accept()?;
    stream.set_nodelay(true)?;
    stream.set_nonblocking(true)?;
    let mut flash = [0xFF; FLASH_BYTES];
    let mut socket =
        Socket { stream, decoder: Decoder::default(), pending: Vec::new(), start: Instant::now() };
    loop {
        serve(&mut socket, &mut flash, *b"slipsense host 1");
        socket.start = Instant::now();
    }
}
