//! What the benchmark program writes: one line of text per measurement, numbers in emulated instructions.

use core::fmt;
use core::str::SplitAsciiWhitespace;

/// Name of a file whose presence asks for the path alone, because the emulator writes down all that is done.
pub const TRACE_FILE: &str = "trace.in";
/// Name of the file that it then makes before the last frame, waiting for the next.
pub const READY_FILE: &str = "ready.out";
/// Name of the file that lets it go on.
pub const GO_FILE: &str = "go.in";
/// Name of a file whose presence asks for the compression alone, of every frame and sensor.
pub const COMPRESSION_FILE: &str = "compress.in";
/// Name of the file that the benchmark program writes.
pub const MEASURED_FILE: &str = "measured.txt";
/// Frames after which every window is full: their numbers are not measurements of a running stream.
pub const WARM_UP_FRAMES: usize = 60;

/// A part of the path from samples to CAN frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Samples to log-mel.
    FrontEnd,
    /// Sum, area, centre, axis of a pad.
    Contact,
    /// Counts and their change into the first map.
    Piezo,
    /// First convolution.
    Conv1,
    /// Second convolution.
    Conv2,
    /// Third convolution.
    Conv3,
    /// Last map to the embedding.
    PiezoDense,
    /// Log-mel to the embedding.
    XlEncoder,
    /// Both cross-attentions.
    CrossAttention,
    /// The attention over time.
    TemporalAttention,
    /// Logits.
    Head,
    /// Slip message and raw messages to CAN frames.
    Wire,
}

/// Number of [`Part`]s.
pub const PARTS: usize = 12;

impl Part {
    /// In the order of the signal.
    pub const ALL: [Self; PARTS] = [
        Self::FrontEnd,
        Self::Contact,
        Self::Piezo,
        Self::Conv1,
        Self::Conv2,
        Self::Conv3,
        Self::PiezoDense,
        Self::XlEncoder,
        Self::CrossAttention,
        Self::TemporalAttention,
        Self::Head,
        Self::Wire,
    ];

    /// For people.
    pub const fn name(self) -> &'static str {
        match self {
            Self::FrontEnd => "accelerometer front end",
            Self::Contact => "contact summary",
            Self::Piezo => "taxels and their change",
            Self::Conv1 => "conv1",
            Self::Conv2 => "conv2",
            Self::Conv3 => "conv3",
            Self::PiezoDense => "dense of the pad",
            Self::XlEncoder => "accelerometer encoder",
            Self::CrossAttention => "cross-attentions",
            Self::TemporalAttention => "attention over time",
            Self::Head => "head",
            Self::Wire => "messages to CAN frames",
        }
    }
}

/// One frame of the path.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameCost {
    /// `Pipeline::step`.
    pub step: u32,
    /// Slip message and raw messages to CAN frames.
    pub wire: u32,
    /// The same frame through a network that is watched, by part, in the order of [`Part::ALL`].
    pub parts: [u32; PARTS],
}

/// One line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line<'a> {
    /// A loop of `expected` instructions was measured to take `measured`.
    Check {
        /// By the loop's code.
        expected: u32,
        /// By the counter.
        measured: u32,
    },
    /// One call of a kernel.
    Kernel {
        /// Multiply-accumulates; 0 where there are none to speak of.
        macs: u32,
        /// Of the call.
        instructions: u32,
        /// Shape included.
        name: &'a str,
    },
    /// One frame.
    Frame(FrameCost),
    /// One sensor's frame compressed.
    Compressed {
        /// Of the message.
        bytes: u32,
        /// From readings to message.
        instructions: u32,
    },
    /// The size of a type, bytes.
    Size {
        /// `size_of`.
        bytes: u32,
        /// The type.
        name: &'a str,
    },
}

impl fmt::Display for Line<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Check { expected, measured } => writeln!(f, "check {expected} {measured}"),
            Self::Kernel { macs, instructions, name } => writeln!(f, "kernel {macs} {instructions} {name}"),
            Self::Frame(FrameCost { step, wire, parts }) => {
                write!(f, "frame {step} {wire}")?;
                parts.iter().try_for_each(|part| write!(f, " {part}"))?;
                writeln!(f)
            }
            Self::Compressed { bytes, instructions } => writeln!(f, "compressed {bytes} {instructions}"),
            Self::Size { bytes, name } => writeln!(f, "size {bytes} {name}"),
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
            "frame" => {
                let mut cost =
                    FrameCost { step: number(&mut words)?, wire: number(&mut words)?, parts: [0; PARTS] };
                for part in &mut cost.parts {
                    *part = number(&mut words)?;
                }
                Some(Self::Frame(cost))
            }
            "compressed" => {
                Some(Self::Compressed { bytes: number(&mut words)?, instructions: number(&mut words)? })
            }
            "size" => {
                let (bytes, name) = rest.split_once(' ')?;
                Some(Self::Size { bytes: bytes.parse().ok()?, name: name.trim_end() })
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
