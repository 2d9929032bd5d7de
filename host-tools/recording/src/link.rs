//! Where frames come from and go to while they happen.
//!
//! | written as | is |
//! |---|---|
//! | `FILE` | a recording, see [`Format`] |
//! | `-` | a candump log on standard input or output |
//! | `slcan:/dev/ttyACM0`, `slcan:HOST:PORT` | a USB adapter, or one behind a TCP port |
//! | `socketcan:can0` | an interface of Linux |

use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use crate::candump::{CandumpReader, CandumpWriter, Foreign, LogEntry, Rule};
use anyhow::{Context, Result, bail};
use slipsense::wire::CanFrame;

use crate::log_file;
use crate::recording::{Format, Record};
use crate::slcan;

/// How long a source that is quiet keeps its reader waiting.
const POLL: Duration = Duration::from_millis(100);

/// A place, as written on the command line.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Place {
    /// Standard input or output.
    Standard,
    File(PathBuf, Format),
    Serial(String),
    /// An slcan adapter behind TCP.
    Tcp(String),
    SocketCan(String),
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "-" {
            return Ok(Self::Standard);
        }
        Ok(match text.split_once(':') {
            Some(("slcan", "")) => return Err("need a device or HOST:PORT after slcan:".to_owned()),
            Some(("slcan", device)) if !device.starts_with('/') && device.contains(':') => {
                Self::Tcp(device.to_owned())
            }
            Some(("slcan", device)) => Self::Serial(device.to_owned()),
            Some(("socketcan", "")) => {
                return Err("need an interface after socketcan:, such as can0".to_owned());
            }
            Some(("socketcan", interface)) => Self::SocketCan(interface.to_owned()),
            _ => {
                let path = Path::new(text);
                // A pipe has no ending that says what comes through it.
                Self::File(path.to_owned(), Format::from_path(path).unwrap_or(Format::Candump))
            }
        })
    }
}

impl Place {
    /// Does it run on, with times of now?
    pub const fn is_live(&self) -> bool {
        matches!(self, Self::Serial(_) | Self::Tcp(_) | Self::SocketCan(_))
    }
}

pub enum Input {
    Frame(LogEntry),
    /// Traffic of others.
    Other(Foreign),
    Idle,
    End,
}

/// A byte stream in both directions.
pub trait Wire: Read + Write + Send {}
impl<T: Read + Write + Send> Wire for T {}

pub enum Source {
    /// Lines of a candump log as they come, and what it is called.
    Lines(CandumpReader<Box<dyn BufRead + Send>>, String),
    File(Box<log_file::Reader>),
    Slcan(SlcanSource),
    SocketCan(socket_can::Socket),
}

/// An slcan adapter and the line that it is in the middle of.
pub struct SlcanSource {
    wire: Box<dyn Wire>,
    line: Vec<u8>,
    ready: std::collections::VecDeque<Input>,
}

/// Open a source. `data_mbit` is the bit rate of the data phase that an slcan adapter is set to.
pub fn open(place: &Place, data_mbit: u8) -> Result<Source> {
    Ok(match place {
        Place::Standard => lines(std::io::stdin(), "standard input".to_owned()),
        Place::File(path, Format::Candump) => {
            let file = File::open(path).with_context(|| format!("{}: cannot read", path.display()))?;
            if path.is_dir() {
                bail!("{}: is a folder, must be a recording", path.display());
            }
            lines(file, path.display().to_string())
        }
        Place::File(path, format) => Source::File(Box::new(log_file::open(path, *format)?)),
        Place::Serial(_) | Place::Tcp(_) => {
            let wire = slcan_wire(place, data_mbit)?;
            Source::Slcan(SlcanSource { wire, line: Vec::new(), ready: Default::default() })
        }
        Place::SocketCan(interface) => Source::SocketCan(socket_can::Socket::open(interface)?),
    })
}

fn lines(input: impl Read + Send + 'static, name: String) -> Source {
    Source::Lines(CandumpReader::new(Box::new(BufReader::new(input))), name)
}

fn slcan_wire(place: &Place, data_mbit: u8) -> Result<Box<dyn Wire>> {
    let mut wire: Box<dyn Wire> = match place {
        Place::Tcp(address) => {
            let stream = TcpStream::connect(address).with_context(|| format!("{address}: cannot connect"))?;
            stream.set_read_timeout(Some(POLL))?;
            stream.set_nodelay(true)?;
            Box::new(stream)
        }
        Place::Serial(device) => {
            // The rate means nothing to an adapter on USB; one with a real UART has its fastest.
            let port = serialport::new(device, 3_000_000).timeout(POLL).open();
            Box::new(port.with_context(|| format!("{device}: cannot open the serial device"))?)
        }
        _ => bail!("{place:?} is no slcan adapter"),
    };
    wire.write_all(slcan::open_commands(data_mbit).as_bytes())
        .context("the adapter does not take commands")?;
    Ok(wire)
}

/// Microseconds since 1970.
pub fn now_us() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64)
}

impl Source {
    /// Wait a moment for the next frame.
    pub fn receive(&mut self) -> Result<Input> {
        match self {
            Self::Lines(lines, name) => Ok(match lines.next() {
                None => Input::End,
                Some(Ok(entry)) => Input::Frame(entry),
                Some(Err(error)) if matches!(error.rule, Rule::NotOurs) => Input::Other(Foreign::Classic),
                Some(Err(error)) => return Err(error).with_context(|| name.clone()),
            }),
            Self::File(records) => loop {
                match records.next().transpose()? {
                    None => break Ok(Input::End),
                    Some(Record::Frame(entry)) => break Ok(Input::Frame(entry)),
                    Some(Record::Displacement { .. }) => {}
                }
            },
            Self::Slcan(adapter) => adapter.receive(),
            Self::SocketCan(socket) => socket.receive(),
        }
    }

    /// What a recording has and no frame says, as [`log_file::Reader::notes`]; complete at the end.
    pub fn notes(&self) -> Vec<String> {
        match self {
            Self::File(records) => records.notes(),
            _ => Vec::new(),
        }
    }

    /// Frames that the kernel has dropped since the source was opened, because nobody fetched them in time; 0 where
    /// no kernel counts.
    pub fn kernel_drops(&self) -> u32 {
        match self {
            Self::SocketCan(socket) => socket.drops(),
            _ => 0,
        }
    }

    pub fn send(&mut self, frame: &CanFrame) -> Result<()> {
        match self {
            Self::Lines(..) | Self::File(_) => bail!("a recording takes no frames: need a bus"),
            Self::Slcan(adapter) => Ok(adapter.wire.write_all(slcan::command(frame).as_bytes())?),
            Self::SocketCan(socket) => socket.send(frame),
        }
    }
}

impl SlcanSource {
    fn receive(&mut self) -> Result<Input> {
        if let Some(input) = self.ready.pop_front() {
            return Ok(input);
        }
        let mut buffer = [0; 4096];
        let length = match self.wire.read(&mut buffer) {
            Ok(0) => return Ok(Input::End),
            Ok(length) => length,
            Err(error) if is_timeout(&error) => return Ok(Input::Idle),
            Err(error) => return Err(error).context("slcan adapter"),
        };
        let timestamp_us = now_us();
        for &byte in &buffer[..length] {
            match byte {
                // BEL: the adapter refused something.
                b'\r' | b'\n' | 7 => {
                    let interface = "slcan0".to_owned();
                    self.ready.extend(slcan::parse(&self.line).map(|line| match line {
                        Ok(frame) => Input::Frame(LogEntry { timestamp_us, interface, frame }),
                        Err(foreign) => Input::Other(foreign),
                    }));
                    self.line.clear();
                }
                // No line is longer: what is without end is no slcan.
                byte if self.line.len() < 256 => self.line.push(byte),
                _ => {}
            }
        }
        Ok(self.ready.pop_front().unwrap_or(Input::Idle))
    }
}

fn is_timeout(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted)
}

/// An open sink of frames.
pub enum Sink {
    Log(CandumpWriter<Box<dyn Write>>),
    Slcan(Box<dyn Wire>),
    SocketCan(socket_can::Socket),
}

/// Open a sink that takes frames at once: not for a log that has to be whole, see [`log_file::write`].
pub fn open_sink(place: &Place, data_mbit: u8) -> Result<Sink> {
    Ok(match place {
        Place::Standard => log_sink(std::io::stdout())?,
        Place::File(path, Format::Candump) => {
            let file = File::create(path).with_context(|| format!("{}: cannot write", path.display()))?;
            log_sink(file)?
        }
        Place::File(path, _) => {
            bail!("{}: `slipsense convert` writes this format, replay writes candump logs", path.display())
        }
        Place::Serial(_) | Place::Tcp(_) => Sink::Slcan(slcan_wire(place, data_mbit)?),
        Place::SocketCan(interface) => Sink::SocketCan(socket_can::Socket::open(interface)?),
    })
}

fn log_sink(out: impl Write + 'static) -> Result<Sink> {
    let out: Box<dyn Write> = Box::new(out);
    Ok(Sink::Log(CandumpWriter::new(out, "can0")?))
}

impl Sink {
    pub fn send(&mut self, entry: &LogEntry) -> Result<()> {
        match self {
            Self::Log(log) => log.write_entry(entry)?,
            Self::Slcan(wire) => wire.write_all(slcan::command(&entry.frame).as_bytes())?,
            Self::SocketCan(socket) => socket.send(&entry.frame)?,
        }
        Ok(())
    }

    /// Write out what is buffered.
    pub fn finish(self) -> Result<()> {
        match self {
            Self::Log(log) => log.finish()?.flush()?,
            Self::Slcan(mut wire) => wire.write_all(slcan::CLOSE.as_bytes())?,
            Self::SocketCan(_) => {}
        }
        Ok(())
    }
}

#[cfg(not(target_os = "linux"))]
mod socket_can {
    use super::*;

    pub enum Socket {}

    impl Socket {
        pub fn open(interface: &str) -> Result<Self> {
            bail!("socketcan:{interface}: SocketCAN is Linux'; use slcan: or candump logs")
        }

        pub fn receive(&mut self) -> Result<Input> {
            match *self {}
        }

        pub fn drops(&self) -> u32 {
            match *self {}
        }

        pub fn send(&mut self, _: &CanFrame) -> Result<()> {
            match *self {}
        }
    }
}

/// Linux' own CAN. `cargo xtask linux` runs it on a virtual interface of Debian's kernel; no adapter has been at it.
#[cfg(target_os = "linux")]
pub mod socket_can {
    use super::*;
    use std::os::fd::AsRawFd;

    use anyhow::anyhow;
    use socketcan::id::FdFlags;
    use socketcan::{
        CanAnyFrame, CanFdFrame, CanFdSocket, EmbeddedFrame, ExtendedId, Frame, Socket as _, SocketOptions,
    };

    /// Room for a second of a full bus.
    const RECEIVE_BUFFER: usize = 8 << 20;
    /// How long a full transmit queue is waited for.
    const SEND_TIMEOUT: Duration = Duration::from_secs(1);
    /// MTU of an interface that carries CAN FD (CANFD_MTU of linux/can.h).
    const FD_MTU: u32 = 72;
    /// Flag of an interface that is up (linux/if.h).
    const IFF_UP: u32 = 1;

    /// An interface in CAN FD mode.
    pub struct Socket {
        socket: CanFdSocket,
        interface: String,
    }

    impl Socket {
        pub fn open(interface: &str) -> Result<Self> {
            let opened = CanFdSocket::open(interface).and_then(|socket| {
                socket.set_read_timeout(POLL)?;
                socket.set_recv_timestamp(true)?;
                socket.set_error_filter_accept_all()?;
                // The kernel caps it at net.core.rmem_max; less loses frames sooner, and losses are counted.
                let _ = socket.as_raw_socket().set_recv_buffer_size(RECEIVE_BUFFER);
                Ok(socket)
            });
            let socket = opened.map_err(|error| {
                anyhow!("socketcan:{interface}: {error}; is the interface up, in FD mode, `ip link show`?")
            })?;
            check_state(interface).map_err(|what| {
                anyhow!("socketcan:{interface}: the interface {what}, see `slipsense record --help`")
            })?;
            Ok(Self { socket, interface: interface.to_owned() })
        }

        /// Wait a moment for a frame; its time is the kernel's.
        pub fn receive(&mut self) -> Result<Input> {
            let (frame, time) = match self.socket.read_frame_with_timestamp() {
                Ok(received) => received,
                Err(error) if is_timeout(&error) => return Ok(Input::Idle),
                Err(error) => return Err(error).with_context(|| format!("socketcan:{}", self.interface)),
            };
            let fd = match frame {
                CanAnyFrame::Fd(fd) if fd.is_extended() => fd,
                CanAnyFrame::Fd(_) => return Ok(Input::Other(Foreign::Standard)),
                CanAnyFrame::Error(_) => return Ok(Input::Other(Foreign::Error)),
                _ => return Ok(Input::Other(Foreign::Classic)),
            };
            let timestamp_us = time.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_micros() as u64);
            let frame = CanFrame::new(fd.raw_id(), fd.data())?;
            Ok(Input::Frame(LogEntry { timestamp_us, interface: self.interface.clone(), frame }))
        }

        /// Frames that the kernel had no room for.
        pub fn drops(&self) -> u32 {
            // SO_MEMINFO (linux/sock_diag.h): nine counters, the last of which are the drops.
            const COUNTERS: usize = 9;
            let mut counters = [0u32; COUNTERS];
            let mut length = size_of_val(&counters) as libc::socklen_t;
            // SAFETY: the kernel writes at most `length` bytes into `counters`, which lives until it returns.
            let failed = unsafe {
                libc::getsockopt(
                    self.socket.as_raw_fd(),
                    libc::SOL_SOCKET,
                    libc::SO_MEMINFO,
                    counters.as_mut_ptr().cast(),
                    &mut length,
                )
            };
            if failed == 0 { counters[COUNTERS - 1] } else { 0 }
        }

        /// Send a frame, waiting while the queue is full.
        pub fn send(&mut self, frame: &CanFrame) -> Result<()> {
            let id = ExtendedId::new(frame.id()).context("identifier")?;
            let fd = CanFdFrame::with_flags(id, frame.data(), FdFlags::BRS).context("frame")?;
            let began = std::time::Instant::now();
            loop {
                match self.socket.write_frame(&fd) {
                    Ok(()) => return Ok(()),
                    // ENOBUFS: the interface's queue is full.
                    Err(error)
                        if (error.raw_os_error() == Some(105) || is_timeout(&error))
                            && began.elapsed() < SEND_TIMEOUT =>
                    {
                        std::thread::sleep(Duration::from_micros(200));
                    }
                    Err(error) => return Err(error).with_context(|| format!("socketcan:{}", self.interface)),
                }
            }
        }
    }
    /// The kernel opens an interface that is down or speaks classic CAN all the same, and then nothing comes.
    fn check_state(interface: &str) -> Result<(), &'static str> {
        let read = |what: &str| std::fs::read_to_string(format!("/sys/class/net/{interface}/{what}"));
        // Without /sys, as in some containers, that is left to the first frame.
        let (Ok(flags), Ok(mtu)) = (read("flags"), read("mtu")) else { return Ok(()) };
        let flags = u32::from_str_radix(flags.trim().trim_start_matches("0x"), 16);
        if flags.is_ok_and(|flags| flags & IFF_UP == 0) {
            return Err("is down");
        }
        if mtu.trim().parse().is_ok_and(|mtu: u32| mtu != FD_MTU) {
            return Err("is not in CAN FD mode");
        }
        Ok(())
    }
}
