//! A place in a board's RAM where a debug probe leaves frames and finds what became of them: the test with hardware in
//! the loop. The program `slipsense-hil` (`src/firmware/bin/hil.rs`) has one, `slipsense hil` is at the other end.
//!
//! ```text
//! host                                board
//! all words ← 0, let it run           Version, FrameAt, AnswerAt, CoreHz, ModelHash, then Magic ← MAGIC
//! Sensors ← 1 to 3                    makes its pipeline for this number
//! frame at FrameAt, then Asked ← n    takes the frame; the CAN frames that it leads to go to AnswerAt
//!                                     Answered ← n
//! reads the answer, next frame
//! ```
//!
//! Each word has one writer, but that the host clears them all after a reset, so that it does not believe what an
//! earlier run left. One frame is under way at a time. What a board cannot go on with, it says in a text at AnswerAt,
//! and sets [`Word::Failed`]. Every word is little-endian, as the core is.

use core::fmt;
use core::sync::atomic::{AtomicU32, Ordering};

use super::replay::{CAN_FRAMES_MAX, FRAME_BYTES_MAX};
use crate::net::format::HASH_BYTES;
use crate::params::MAX_SENSORS;
use crate::wire::{CanFrame, FRAME_PAYLOAD};

/// Name of the static in the program, by which the host finds it.
pub const SYMBOL: &str = "SLIPSENSE_MAILBOX";
/// "HILM".
pub const MAGIC: u32 = u32::from_le_bytes(*b"HILM");
/// Raised by every change of what is in this file or of a frame's bytes.
pub const VERSION: u32 = 1;

/// Bytes of a word.
const WORD: usize = size_of::<u32>();
/// Words of a model's hash.
pub const HASH_WORDS: usize = HASH_BYTES / WORD;
/// Words of the largest frame, [`replay`](super::replay)'s bytes.
pub const FRAME_WORDS: usize = FRAME_BYTES_MAX / WORD;
/// Words before the CAN frames of an answer: cycles of the pipeline, and how many frames follow.
pub const ANSWER_HEADER_WORDS: usize = 2;
/// Bytes of data that a CAN frame has at most: Cyphal's payload and its tail byte.
const CAN_DATA_BYTES: usize = FRAME_PAYLOAD + 1;
/// Words of a CAN frame: identifier, length in bytes, data.
pub const CAN_WORDS: usize = 2 + CAN_DATA_BYTES / WORD;
/// Words of the longest answer.
pub const ANSWER_WORDS: usize = ANSWER_HEADER_WORDS + CAN_FRAMES_MAX * CAN_WORDS;
const _: () = assert!(FRAME_BYTES_MAX.is_multiple_of(WORD) && HASH_BYTES.is_multiple_of(WORD));

/// What the words of a [`Mailbox`] hold, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Word {
    /// [`MAGIC`]: the words of the board are there.
    Magic = 0,
    /// [`VERSION`].
    Version = 1,
    /// Address of [`FRAME_WORDS`] words.
    FrameAt = 2,
    /// Address of [`ANSWER_WORDS`] words.
    AnswerAt = 3,
    /// Clock of the core, Hz: cycles to time.
    CoreHz = 4,
    /// 1: the board has given up, and a text at AnswerAt says why: its length in bytes, then UTF-8.
    Failed = 5,
    /// Number of the last frame that was answered, counted from 1.
    Answered = 6,
    /// By the host: sensors of the frames to come, 1 to [`MAX_SENSORS`]. Looked at once.
    Sensors = 7,
    /// By the host: number of the frame that waits.
    Asked = 8,
    /// Hash of the model in use, the first of [`HASH_WORDS`] words.
    ModelHash = 9,
}

/// Words of a [`Mailbox`].
pub const MAILBOX_WORDS: usize = Word::ModelHash as usize + HASH_WORDS;

/// The words that board and host talk through; zeros at start.
#[repr(transparent)]
#[derive(Debug)]
pub struct Mailbox([AtomicU32; MAILBOX_WORDS]);

impl Mailbox {
    /// Nothing said yet.
    pub const fn new() -> Self {
        Self([const { AtomicU32::new(0) }; MAILBOX_WORDS])
    }

    fn get(&self, word: Word) -> u32 {
        self.0.get(word as usize).map_or(0, |word| word.load(Ordering::Acquire))
    }

    fn set(&self, word: Word, value: u32) {
        if let Some(word) = self.0.get(word as usize) {
            word.store(value, Ordering::Release);
        }
    }

    /// The words, for who shows them to a host without a probe: a test.
    pub const fn words(&self) -> &[AtomicU32] {
        &self.0
    }
}

impl Default for Mailbox {
    fn default() -> Self {
        Self::new()
    }
}

/// The board's end.
#[derive(Clone, Copy, Debug)]
pub struct BoardEnd {
    mailbox: &'static Mailbox,
    frame: &'static [AtomicU32; FRAME_WORDS],
    answer: &'static [AtomicU32; ANSWER_WORDS],
}

impl BoardEnd {
    /// `frame` and `answer` in memory that neither the core's cache nor anything else holds back from the probe; what
    /// is in them at first does not matter.
    pub const fn new(
        mailbox: &'static Mailbox,
        frame: &'static [AtomicU32; FRAME_WORDS],
        answer: &'static [AtomicU32; ANSWER_WORDS],
    ) -> Self {
        Self { mailbox, frame, answer }
    }

    /// Tell the host where things are, before anything can fail. `frame_at` and `answer_at`: addresses of the two areas.
    pub fn place(&self, (frame_at, answer_at): (u32, u32), core_hz: u32) {
        self.mailbox.set(Word::Version, VERSION);
        self.mailbox.set(Word::FrameAt, frame_at);
        self.mailbox.set(Word::AnswerAt, answer_at);
        self.mailbox.set(Word::CoreHz, core_hz);
    }

    /// Tell the host that this board is ready, with this model.
    pub fn open(&self, model_hash: &[u8; HASH_BYTES]) {
        let hash = self.mailbox.0.iter().skip(Word::ModelHash as usize);
        for (word, bytes) in hash.zip(model_hash.as_chunks().0) {
            word.store(u32::from_le_bytes(*bytes), Ordering::Relaxed);
        }
        self.mailbox.set(Word::Magic, MAGIC);
    }

    /// Sensors of the frames to come, once the host has said so.
    pub fn sensors(&self) -> Option<usize> {
        let sensors = self.mailbox.get(Word::Sensors) as usize;
        (1..=MAX_SENSORS).contains(&sensors).then_some(sensors)
    }

    /// The number of the frame that waits for an answer, if one does. Numbers wrap.
    pub fn waiting(&self) -> Option<u32> {
        let asked = self.mailbox.get(Word::Asked);
        (asked != self.mailbox.get(Word::Answered)).then_some(asked)
    }

    /// The bytes of the frame that waits, as many as fit `bytes`. The answer begins empty.
    pub fn take(&self, bytes: &mut [u8]) {
        for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(self.frame) {
            *bytes = word.load(Ordering::Relaxed).to_le_bytes();
        }
        self.answer.iter().take(ANSWER_HEADER_WORDS).for_each(|word| word.store(0, Ordering::Relaxed));
    }

    /// A CAN frame that it led to. More than [`CAN_FRAMES_MAX`] are counted and not kept: the host refuses the answer.
    pub fn sent(&self, frame: &CanFrame) {
        let Some((header, frames)) = self.answer.split_first_chunk::<ANSWER_HEADER_WORDS>() else { return };
        let [_, count] = header;
        let number = count.load(Ordering::Relaxed);
        if let Some([id, length, data @ ..]) = frames.as_chunks::<CAN_WORDS>().0.get(number as usize) {
            id.store(frame.id(), Ordering::Relaxed);
            length.store(frame.data().len() as u32, Ordering::Relaxed);
            store(data, frame.data());
        }
        count.store(number.saturating_add(1), Ordering::Relaxed);
    }

    /// How long the pipeline took, cycles of the core.
    pub fn took(&self, cycles: u32) {
        if let Some(word) = self.answer.first() {
            word.store(cycles, Ordering::Relaxed);
        }
    }

    /// The answer to the frame that waits is whole.
    pub fn answered(&self) {
        self.mailbox.set(Word::Answered, self.mailbox.get(Word::Asked));
    }

    /// Nothing more will come, because of this.
    pub fn fail(&self, why: fmt::Arguments<'_>) {
        let mut text = Text(heapless::Vec::new());
        // What does not fit is cut off.
        let _ = fmt::write(&mut text, why);
        if let Some((length, words)) = self.answer.split_first() {
            length.store(text.0.len() as u32, Ordering::Relaxed);
            store(words, &text.0);
        }
        self.mailbox.set(Word::Failed, 1);
    }
}

/// Bytes in words, the last one filled up with zeros.
fn store(words: &[AtomicU32], bytes: &[u8]) {
    for (word, bytes) in words.iter().zip(bytes.chunks(WORD)) {
        let mut padded = [0; WORD];
        padded.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
        word.store(u32::from_le_bytes(padded), Ordering::Relaxed);
    }
}

/// Bytes of a reason at most.
pub const TEXT_BYTES_MAX: usize = 400;

/// A reason, cut after so many bytes, even inside a character.
struct Text(heapless::Vec<u8, TEXT_BYTES_MAX>);

impl fmt::Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        text.bytes().try_for_each(|byte| self.0.push(byte)).map_err(|_| fmt::Error)
    }
}

/// What became of one frame, as the host reads it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// How long the pipeline took, cycles of the core.
    pub step_cycles: u32,
    /// What would have gone onto the bus, in order.
    pub can: heapless::Vec<CanFrame, CAN_FRAMES_MAX>,
}

/// Words of an answer, by its first [`ANSWER_HEADER_WORDS`]; `None` if it would be longer than any is.
pub fn answer_words(header: &[u32; ANSWER_HEADER_WORDS]) -> Option<usize> {
    let [_, count] = header;
    let words = ANSWER_HEADER_WORDS + CAN_WORDS * usize::try_from(*count).ok()?.min(ANSWER_WORDS);
    (words <= ANSWER_WORDS).then_some(words)
}

impl Answer {
    /// `None` if these words are none.
    pub fn decode(words: &[u32]) -> Option<Self> {
        let (header, frames) = words.split_first_chunk()?;
        let frames = frames.get(..answer_words(header)? - ANSWER_HEADER_WORDS)?;
        let mut can = heapless::Vec::new();
        for [id, length, data @ ..] in frames.as_chunks::<CAN_WORDS>().0 {
            let mut bytes = [0; CAN_DATA_BYTES];
            for (bytes, word) in bytes.as_chunks_mut().0.iter_mut().zip(data) {
                *bytes = word.to_le_bytes();
            }
            can.push(CanFrame::new(*id, bytes.get(..*length as usize)?).ok()?).ok()?;
        }
        let [step_cycles, _] = *header;
        Some(Self { step_cycles, can })
    }
}

/// A board's reason, from the words at its answer's place.
pub fn reason(words: &[u32]) -> Option<heapless::String<TEXT_BYTES_MAX>> {
    let (length, words) = words.split_first()?;
    let mut bytes: heapless::Vec<u8, TEXT_BYTES_MAX> = heapless::Vec::new();
    let text = words.iter().flat_map(|word| word.to_le_bytes()).take(*length as usize);
    for byte in text {
        bytes.push(byte).ok()?;
    }
    // Cut inside a character, a text ends before it.
    let whole = match core::str::from_utf8(&bytes) {
        Ok(text) => text,
        Err(error) => core::str::from_utf8(bytes.get(..error.valid_up_to())?).ok()?,
    };
    heapless::String::try_from(whole).ok()
}
