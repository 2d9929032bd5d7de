//! A board behind a GDB server: the library's mailbox and pipeline in memory that packets read and write, and what can
//! be wrong with one.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread;

use slipsense::board::mailbox::{ANSWER_WORDS, BoardEnd, FRAME_WORDS, Mailbox, Word};
use slipsense::board::replay::{FRAME_BYTES_MAX, decode_parts, decode_stamp};
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::Pipeline;
use slipsense::sensor::SensorReadings;
use slipsense::wire::{NodeId, Origin, RawBuffer, Transmitter};

use crate::support::elf_header;

/// Where its memory is.
pub const MAILBOX_AT: u32 = 0x2000_6000;
const FRAME_AT: u32 = 0x3000_0000;
const ANSWER_AT: u32 = 0x3001_0000;
pub const CORE_HZ: u32 = 480_000_000;
/// Cycles that it claims for frame n: n + this.
pub const CYCLES: u32 = 1000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    None,
    /// Another program, which writes nothing.
    OtherProgram,
    Version,
    Stops(u32),
    GivesUp(u32),
    /// A bit of a raw CAN frame differs in the frame of this number.
    FlipsBit(u32),
    /// The last CAN frame of the frame of this number is lost.
    LosesFrame(u32),
    /// The answer claims more CAN frames than fit.
    TooLong,
    /// The server knows no `monitor reset halt`.
    NoReset,
}

/// Serve one debugger; the port.
pub fn serve(model: Vec<u8>, fault: Fault) -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a free port");
    let port = listener.local_addr().expect("it is bound").port();
    thread::spawn(move || {
        let (stream, _) = listener.accept().expect("the command connects");
        Board::new(stream, &model, fault).serve();
    });
    port
}

struct Board {
    stream: BufReader<TcpStream>,
    fault: Fault,
    mailbox: &'static Mailbox,
    frame: &'static [AtomicU32; FRAME_WORDS],
    answer: &'static [AtomicU32; ANSWER_WORDS],
    host: BoardEnd,
    model: Model<'static>,
    pipeline: Option<Pipeline<'static>>,
    transmitter: Transmitter,
}

impl Board {
    fn new(stream: TcpStream, model: &[u8], fault: Fault) -> Self {
        let mailbox: &'static Mailbox = Box::leak(Box::default());
        let frame = &*Box::leak(Box::new([const { AtomicU32::new(0) }; FRAME_WORDS]));
        let answer = &*Box::leak(Box::new([const { AtomicU32::new(0) }; ANSWER_WORDS]));
        // What an earlier run left: nobody may believe it.
        mailbox.words().iter().for_each(|word| word.store(1, Ordering::Relaxed));
        let model = Model::parse(Box::leak(model.to_vec().into_boxed_slice())).expect("a model");
        let (host, transmitter) = (BoardEnd::new(mailbox, frame, answer), Transmitter::new(NodeId::DEFAULT));
        let stream = BufReader::new(stream);
        Self { stream, fault, mailbox, frame, answer, host, model, pipeline: None, transmitter }
    }

    fn words(&self, address: u32) -> &'static [AtomicU32] {
        let areas: [(u32, &'static [AtomicU32]); 3] =
            [(MAILBOX_AT, self.mailbox.words()), (FRAME_AT, self.frame), (ANSWER_AT, self.answer)];
        let inside = |(start, words): (u32, &'static [AtomicU32])| {
            let at = address.checked_sub(start)? as usize / 4;
            words.get(at..).filter(|words| !words.is_empty())
        };
        areas.into_iter().find_map(inside).unwrap_or_default()
    }

    fn word(&self, word: Word) -> &AtomicU32 {
        &self.mailbox.words()[word as usize]
    }

    /// What its program does while it may run.
    fn run(&mut self) {
        let fault = self.fault;
        if fault == Fault::OtherProgram {
            return;
        }
        if self.word(Word::Magic).load(Ordering::Relaxed) == 0 {
            self.host.place((FRAME_AT, ANSWER_AT), CORE_HZ);
            self.host.open(&self.model.hash);
            if fault == Fault::Version {
                self.word(Word::Version).store(99, Ordering::Relaxed);
            }
        }
        let (Some(sensors), Some(number)) = (self.host.sensors(), self.host.waiting()) else { return };
        match fault {
            Fault::Stops(at) if at == number => return,
            Fault::GivesUp(at) if at == number => {
                self.host.fail(format_args!("no {} left", "bananas"));
                return;
            }
            _ => {}
        }
        let mut bytes = [0; FRAME_BYTES_MAX];
        self.host.take(&mut bytes);
        let stamp = decode_stamp(&bytes).expect("a stamp");
        let mut parts = [const { SensorReadings::new() }; MAX_SENSORS];
        decode_parts(&bytes, &mut parts[..sensors]).expect("a frame");
        let pipeline =
            self.pipeline.get_or_insert_with(|| Pipeline::new(self.model, sensors).expect("sensors"));
        let inputs = parts.each_ref().map(|part| part.input());
        let output = pipeline.step(&inputs[..sensors]);
        let mut can = vec![self.transmitter.slip(&output.slip_message(stamp, &Origin::default()))];
        let mut buffer = RawBuffer::new();
        for (sensor, part) in parts.iter().enumerate().take(sensors) {
            let raw = output.raw_frame(stamp, sensor, part.input());
            can.extend(self.transmitter.raw(&raw, &mut buffer));
        }
        if fault == Fault::LosesFrame(number) {
            can.pop();
        }
        can.iter().for_each(|frame| self.host.sent(frame));
        if fault == Fault::FlipsBit(number) {
            // The last byte of the second CAN frame's first word of data.
            self.answer[2 + 18 + 2].fetch_xor(1 << 24, Ordering::Relaxed);
        }
        if fault == Fault::TooLong {
            self.answer[1].store(u32::MAX, Ordering::Relaxed);
        }
        self.host.took(number + CYCLES);
        self.host.answered();
    }

    /// Be its debugger's server, until the debugger goes.
    fn serve(&mut self) {
        while let Some(packet) = self.packet() {
            let answer = self.answer(&packet);
            self.send(&answer);
        }
    }

    fn packet(&mut self) -> Option<String> {
        let (mut packet, mut sum) = (Vec::new(), [0; 2]);
        self.stream.skip_until(b'$').ok()?;
        self.stream.read_until(b'#', &mut packet).ok()?;
        self.stream.read_exact(&mut sum).ok()?;
        packet.pop();
        let expected = format!("{:02x}", packet.iter().copied().fold(0u8, u8::wrapping_add));
        assert_eq!(sum, expected.as_bytes(), "the checksum");
        self.stream.get_mut().write_all(b"+").ok()?;
        String::from_utf8(packet).ok()
    }

    fn send(&mut self, packet: &str) {
        let sum = packet.bytes().fold(0u8, u8::wrapping_add);
        // A debugger that has seen enough does not wait for the answer.
        let _ = write!(self.stream.get_mut(), "${packet}#{sum:02x}");
    }

    fn answer(&mut self, packet: &str) -> String {
        let number = |text: &str| u32::from_str_radix(text, 16).expect("a number");
        match packet.split_at(1) {
            ("?", _) => "S05".to_owned(),
            // "monitor reset halt", answered by a text and then OK.
            ("q", rest) => {
                assert_eq!(rest, "Rcmd,72657365742068616c74");
                if self.fault == Fault::NoReset {
                    return String::new();
                }
                self.send("O6f6b0a");
                "OK".to_owned()
            }
            ("c", _) => {
                self.run();
                let _ = self.stream.skip_until(0x03);
                "T02thread:1;".to_owned()
            }
            ("m", rest) => {
                let (address, bytes) = rest.split_once(',').expect("address and length");
                let words = self.words(number(address)).iter().take(number(bytes) as usize / 4);
                let hex = words.map(|word| format!("{:08x}", word.load(Ordering::Relaxed).swap_bytes()));
                let hex: String = hex.collect();
                if hex.is_empty() { "E14".to_owned() } else { hex }
            }
            ("M", rest) => {
                let (place, data) = rest.split_once(':').expect("data");
                let (address, _) = place.split_once(',').expect("address and length");
                let words = self.words(number(address));
                for (at, word) in words.iter().zip(data.as_bytes().chunks(8)) {
                    let word = number(std::str::from_utf8(word).expect("digits")).swap_bytes();
                    at.store(word, Ordering::Relaxed);
                }
                "OK".to_owned()
            }
            _ => String::new(),
        }
    }
}

/// An ELF of 32 bits for ARM with nothing in it but a symbol.
pub fn elf(symbol: &str, address: u32) -> Vec<u8> {
    let word = |value: u32| value.to_le_bytes().to_vec();
    let strings = [&b"\0"[..], symbol.as_bytes(), &[0; 4]].concat();
    let (symbols, names) = (52u32, 52 + 32);
    let sections = (names + strings.len() as u32).next_multiple_of(4);
    // A global object at an absolute address.
    let symbols_table =
        [vec![0; 16], word(1), word(address), word(4), vec![0x11, 0], 0xFFF1_u16.to_le_bytes().to_vec()];
    let mut elf = [elf_header((0, 0), (sections, 3)), symbols_table.concat(), strings.clone()].concat();
    elf.resize(sections as usize, 0);
    elf.extend([0; 40]);
    elf.extend([0, 2, 0, 0, symbols, 32, 2, 1, 4, 16].map(word).concat());
    elf.extend([0, 3, 0, 0, names, strings.len() as u32, 0, 0, 1, 0].map(word).concat());
    elf
}
