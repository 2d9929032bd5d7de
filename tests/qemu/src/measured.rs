//! What the benchmark program writes: one line of text per measurement, numbers in emulated instructions.

use core::fmt;
use core::str::SplitAsciiWhitespace;

/// Name of a file whose presence asks for the path alone, because the emulator writes down all that is done.
pub const TRACE_FILE: &str = "trace.in";
/// Name of the file that it then makes before the last frame, waiting for the next.
pub const READY_FILE: &str = "ready.out";
pub const GO_FILE: &str = "go.in";
/// Name of a file whose presence asks for the compression alone, of every frame and sensor.
pub const COMPRESSION_FILE: &str = "compress.in";
/// Name of the file that the benchmark program writes.
pub const MEASURED_FILE: &str = "measured.txt";
/// Frames after which every window is full: their numbers are not measurements of a running stream.
pub const WARM_UP_FRAMES: usize = 60;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line<'a> {
    /// A loop of `expected` instructions was measured to take `measured`.
    Check {
        /// By the loop's code.
        expected: u32,
        /// By the counter.
        measured: u32,
    },
    Kernel {
        /// Multiply-accumulates; 0 where there are none to speak of.
        macs: u32,
        instructions: u32,
        /// Shape included.
        name: &'a str,
    },
    Frame {
        /// `Pipeline::step`.
        step: u32,
        /// Slip message and raw messages to CAN frames.
        wire: u32,
    },
    /// One sensor's frame compressed.
    Compressed {
        bytes: u32,
        /// From readings to message.
        instructions: u32,
    },
}

impl fmt::Display for Line<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Check { expected, measured } => writeln!(f, "check {expected} {measured}"),
            Self::Kernel { macs, instructions, name } => writeln!(f, "kernel {macs} {instructions} {name}"),
            Self::Frame { step, wire } => writeln!(f, "frame {step} {wire}"),
            Self::Compressed { bytes, instructions } => writeln!(f, "compressed {bytes} {instructions}"),
        }
    }
}

impl<'a> Line<'a> {
    /// `None` if `text` is no line of [`Display`](fmt::Display).
    pub fn parse(text: &'a str) -> Option<Self> {
        let (kind, rest) = text.split_once(' ')?;
        let mut words = rest.split_ascii_whitespace();
        match kind {
            "check" => Some(Self::Check { expected: number(&mut words)?, measured: number(&mut words)? }),
            "kernel" => {
                let (macs, instructions, name) = call(rest)?;
                Some(Self::Kernel { macs, instructions, name })
            }
            "frame" => Some(Self::Frame { step: number(&mut words)?, wire: number(&mut words)? }),
            "compressed" => {
                Some(Self::Compressed { bytes: number(&mut words)?, instructions: number(&mut words)? })
            }
            _ => None,
        }
    }
}

/// Multiply-accumulates, instructions, name.
fn call(text: &str) -> Option<(u32, u32, &str)> {
    let (macs, rest) = text.split_once(' ')?;
    let (instructions, name) = rest.split_once(' ')?;
    Some((macs.parse().ok()?, instructions.parse().ok()?, name.trim_end()))
}

fn number(words: &mut SplitAsciiWhitespace<'_>) -> Option<u32> {
    words.next()?.parse().ok()
}
