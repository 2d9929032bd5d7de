//! uavcan.file.Read, service 408, the client's side: a file of another node, piece by piece.
//!
//! One request, one answer of at most [`CHUNK_BYTES`], and only when the board has put it away the next request. A piece
//! that is shorter than full is the last. A server that does not answer is asked [`TRIES`] times.

use core::fmt;

use heapless::Vec;

use super::fields::Fields;
use crate::wire::NodeId;
use crate::wire::bytes::Writer;

/// Service of uavcan.file.Read.1.1.
pub const FILE_READ_PORT: u16 = 408;
/// Bytes of a full piece: the standard's.
pub const CHUNK_BYTES: usize = 256;
/// Bytes of the longest path.
pub const PATH_MAX: usize = 255;
/// Time that a server has to answer, µs.
pub const ANSWER_TIMEOUT_US: u64 = 1_000_000;
/// Requests for one piece before the file is given up.
pub const TRIES: u8 = 5;

pub(super) const REQUEST_BYTES: usize = 5 + 1 + PATH_MAX;

/// A path on a file server, not looked into here.
pub type FilePath = Vec<u8, PATH_MAX>;

/// A file of another node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileRef {
    /// The node that serves it.
    pub server: NodeId,
    /// Its path there.
    pub path: FilePath,
}

/// What a file is to become.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum UpdateTarget {
    Firmware,
    Model,
}

impl UpdateTarget {
    /// In words.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Firmware => "firmware",
            Self::Model => "model",
        }
    }
}

/// A piece of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// What the file is to become.
    pub target: UpdateTarget,
    /// Where in the file the piece stands, bytes.
    pub offset: u32,
    /// The piece; may be empty if it is the last.
    pub bytes: Vec<u8, CHUNK_BYTES>,
    /// Is the file complete with it?
    pub last: bool,
    /// Which file since start, so that a late answer for an abandoned one is recognized.
    pub(super) number: u32,
}

/// Puts the pieces of a file away. A board's flash, a test's memory.
#[allow(async_fn_in_trait, reason = "as in the board's seam")]
pub trait FileSink {
    /// Put a piece away. Pieces come in order and without gaps; offset 0 begins anew. The error says why not, in
    /// words for the bus.
    async fn write(&mut self, target: UpdateTarget, offset: u32, bytes: &[u8]) -> Result<(), &'static str>;

    /// The file is complete: `length` bytes. Checks it.
    async fn finish(&mut self, target: UpdateTarget, length: u32) -> Result<(), &'static str>;
}

impl Chunk {
    /// Hand the piece to `sink`, and the end of the file after the last one. What comes out goes to
    /// [`Node::chunk_done`](super::Node::chunk_done).
    pub async fn deliver(&self, sink: &mut impl FileSink) -> Result<(), &'static str> {
        if !self.bytes.is_empty() || self.offset == 0 {
            sink.write(self.target, self.offset, &self.bytes).await?;
        }
        if self.last {
            let length = self.offset.saturating_add(self.bytes.len() as u32);
            sink.finish(self.target, length).await?;
        }
        Ok(())
    }
}

/// Why a file was given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the text says it")]
pub enum FileFailure {
    Silent,
    /// The server refused, with an error number of uavcan.file.Error.1.0.
    Server(u16),
    Answer,
    /// The file is longer than there is room for, bytes.
    TooLong(u32),
    Refused(&'static str),
    Replaced,
}

impl fmt::Display for FileFailure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Silent => write!(f, "the server did not answer {TRIES} requests"),
            Self::Server(2) => f.write_str("the server has no such file"),
            Self::Server(error) => write!(f, "the server refused it, uavcan.file.Error {error}"),
            Self::Answer => f.write_str("the server's answer is cut short"),
            Self::TooLong(most) => write!(f, "longer than {most} bytes"),
            Self::Refused(why) => f.write_str(why),
            Self::Replaced => f.write_str("another file was asked for"),
        }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
enum State {
    Ask,
    /// Asked at this time, the n-th time, by this transfer identifier.
    Asked {
        at_us: u64,
        tries: u8,
        transfer: u8,
    },
    /// The piece waits for the board.
    Ready,
    /// The board is putting the piece away.
    Taken,
}

/// One file on its way.
#[derive(Clone, Debug)]
pub(super) struct FileRead {
    pub target: UpdateTarget,
    pub file: FileRef,
    length_max: u32,
    state: State,
    chunk: Chunk,
}

/// What is to be done now.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Next {
    Ask,
    Wait(u64),
    /// Nothing: the board has a piece.
    Board,
    GiveUp(FileFailure),
}

impl FileRead {
    pub fn new(target: UpdateTarget, file: FileRef, length_max: u32, number: u32) -> Self {
        let chunk = Chunk { target, offset: 0, bytes: Vec::new(), last: false, number };
        Self { target, file, length_max, state: State::Ask, chunk }
    }

    /// Is the board checking the whole file, and installing it if it is right?
    pub fn is_ending(&self) -> bool {
        self.state == State::Taken && self.chunk.last
    }

    pub fn next(&self, now_us: u64) -> Next {
        match self.state {
            State::Ask => Next::Ask,
            State::Asked { at_us, tries, .. } => match at_us.saturating_add(ANSWER_TIMEOUT_US) {
                deadline if now_us < deadline => Next::Wait(deadline),
                _ if tries >= TRIES => Next::GiveUp(FileFailure::Silent),
                _ => Next::Ask,
            },
            State::Ready | State::Taken => Next::Board,
        }
    }

    /// The request; its length. `transfer` is the identifier it will have.
    pub fn request(&mut self, transfer: u8, now_us: u64, out: &mut [u8; REQUEST_BYTES]) -> usize {
        let tries = match self.state {
            State::Asked { tries, .. } => tries.saturating_add(1),
            _ => 1,
        };
        self.state = State::Asked { at_us: now_us, tries, transfer };
        let mut writer = Writer::new(out);
        writer.put_saturated::<5>(self.chunk.offset.into());
        writer.put(&[self.file.path.len() as u8]);
        writer.put(&self.file.path);
        writer.len()
    }

    /// An answer of `server`. One that was not waited for is passed over.
    pub fn accept(&mut self, server: NodeId, transfer: u8, payload: &[u8]) -> Result<(), FileFailure> {
        match self.state {
            State::Asked { transfer: asked, .. } if asked == transfer && server == self.file.server => {}
            _ => return Ok(()),
        }
        let mut fields = Fields::new(payload);
        let error = fields.unsigned::<2>() as u16;
        if error != 0 {
            return Err(FileFailure::Server(error));
        }
        let length = fields.unsigned::<2>() as usize;
        let bytes = fields.slice(length);
        if !fields.is_whole() || length > CHUNK_BYTES {
            return Err(FileFailure::Answer);
        }
        let end = self.chunk.offset.saturating_add(length as u32);
        if end > self.length_max {
            return Err(FileFailure::TooLong(self.length_max));
        }
        // There is room: checked above.
        self.chunk.bytes = Vec::from_slice(bytes).unwrap_or_default();
        self.chunk.last = length < CHUNK_BYTES;
        self.state = State::Ready;
        Ok(())
    }

    pub fn take_chunk(&mut self) -> Option<Chunk> {
        if self.state != State::Ready {
            return None;
        }
        self.state = State::Taken;
        Some(self.chunk.clone())
    }

    /// The board has put the piece away; `Some`: the file is complete; its bytes.
    pub fn advance(&mut self) -> Option<u32> {
        if self.state != State::Taken {
            return None;
        }
        self.chunk.offset = self.chunk.offset.saturating_add(self.chunk.bytes.len() as u32);
        if self.chunk.last {
            return Some(self.chunk.offset);
        }
        self.state = State::Ask;
        None
    }

    /// Is the board putting this piece away?
    pub fn is_taken(&self, chunk: &Chunk) -> bool {
        self.state == State::Taken && self.chunk.number == chunk.number && self.chunk.offset == chunk.offset
    }
}
