//! An episode into a board's mailbox, and its answers beside this computer's.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use slipsense::board::mailbox::{
    ANSWER_HEADER_WORDS, ANSWER_WORDS, Answer, HASH_WORDS, MAGIC, MAILBOX_WORDS, TEXT_BYTES_MAX, VERSION,
    Word, answer_words, reason,
};
use slipsense::board::replay::encode_frame;
use slipsense::net::Model;
use slipsense::pipeline::FrameStamp;
use slipsense::wire::{CanFrame, RawForm};
use slipsense_recording::Episode;

use super::Target;
use crate::simulate::simulate;
use crate::summary::hex;

/// Pause between two polls of the board, first and longest.
const POLL: [Duration; 2] = [Duration::from_micros(500), Duration::from_millis(20)];
const DESCRIBED_MAX: usize = 20;

/// A CAN frame that is not the one expected.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Difference {
    pub frame: usize,
    /// Place of the CAN frame among those of the frame: 0 is the slip message.
    pub can_frame: usize,
    /// What this computer sends; none: it sends fewer.
    pub expected: Option<String>,
    /// What the board sends; none: it sends fewer.
    pub found: Option<String>,
}

#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Its file.
    pub episode: String,
    pub sensors: usize,
    pub frames: usize,
    pub differing_frames: usize,
    pub can_frames: usize,
    pub first: Vec<Difference>,
    /// Cycles of the board's core that the pipeline took for a frame, at most.
    pub worst_step_cycles: u32,
    pub worst_step_frame: usize,
    pub core_hz: u32,
    pub worst_step_us: f64,
    /// How long it took here, s.
    pub seconds: f64,
}

pub struct Run<'a> {
    pub mailbox: u32,
    pub name: String,
    pub episode: &'a Episode,
    pub frames: usize,
    pub model: Model<'a>,
    /// How long the board may take for any step.
    pub timeout: Duration,
}

/// Replay it, from reset, with `progress` after each frame. The report's seconds hold this computer's pipeline too.
pub fn replay(target: &mut dyn Target, run: &Run<'_>, mut progress: impl FnMut()) -> Result<Report> {
    let begun = Instant::now();
    let mut board = Board { target, run, areas: (0, 0) };
    let core_hz = board.open()?;
    let (episode, sensors) = (run.name.clone(), run.episode.sensors);
    let mut report = Report { episode, sensors, frames: run.frames, core_hz, ..Report::default() };
    simulate(run.episode, run.frames, run.model, RawForm::Plain, |stamp, expected| {
        let answer = board.answer(stamp)?;
        report.compare(stamp.sequence as usize, expected, &answer);
        progress();
        Ok(())
    })?;
    report.worst_step_us = f64::from(report.worst_step_cycles) * 1e6 / f64::from(core_hz.max(1));
    report.seconds = begun.elapsed().as_secs_f64();
    Ok(report)
}

struct Board<'t> {
    target: &'t mut dyn Target,
    run: &'t Run<'t>,
    /// Addresses of frame and answer.
    areas: (u32, u32),
}

impl Board<'_> {
    fn word(&self, word: Word) -> u32 {
        self.run.mailbox + 4 * word as u32
    }

    /// From reset to the first frame; the core's clock.
    fn open(&mut self) -> Result<u32> {
        let run = self.run;
        self.target.reset()?;
        self.target.write(run.mailbox, &[0; MAILBOX_WORDS])?;
        let words = self.wait(Word::Magic, MAGIC)?.with_context(|| {
            let seconds = run.timeout.as_secs_f32();
            format!("the board's program does not come up for {seconds} s: is it the program of --elf?")
        })?;
        self.areas = (words[Word::FrameAt as usize], words[Word::AnswerAt as usize]);
        self.refuse_failed(&words)?;
        let version = words[Word::Version as usize];
        ensure!(version == VERSION, "the board speaks version {version} of the mailbox, this is {VERSION}");
        let hash = words[Word::ModelHash as usize..][..HASH_WORDS].iter().flat_map(|word| word.to_le_bytes());
        let hash: Vec<u8> = hash.collect();
        ensure!(
            hash == run.model.hash,
            "the board has the model {}, to be compared with {}: build its program with that, or give --model",
            hex(&hash[..4]),
            hex(&run.model.hash[..4])
        );
        self.target.write(self.word(Word::Sensors), &[run.episode.sensors as u32])?;
        Ok(words[Word::CoreHz as usize])
    }

    /// Let the board run until a word of its mailbox has this value or it fails; the mailbox, `None` after the timeout.
    fn wait(&mut self, word: Word, value: u32) -> Result<Option<[u32; MAILBOX_WORDS]>> {
        let begun = Instant::now();
        let [mut pause, longest] = POLL;
        let mut words = [0; MAILBOX_WORDS];
        while begun.elapsed() < self.run.timeout {
            self.target.run_for(pause)?;
            self.target.read(self.run.mailbox, &mut words)?;
            if words[word as usize] == value || words[Word::Failed as usize] == 1 {
                return Ok(Some(words));
            }
            pause = (2 * pause).min(longest);
        }
        Ok(None)
    }

    fn refuse_failed(&mut self, words: &[u32; MAILBOX_WORDS]) -> Result<()> {
        if words[Word::Failed as usize] != 1 {
            return Ok(());
        }
        if words[Word::AnswerAt as usize] == 0 {
            bail!("the board's program gave up before it could report why");
        }
        let mut text = [0; 1 + TEXT_BYTES_MAX.div_ceil(4)];
        self.target.read(self.areas.1, &mut text)?;
        bail!("the board's program gives up: {}", reason(&text).unwrap_or_default())
    }

    fn answer(&mut self, stamp: FrameStamp) -> Result<Answer> {
        let (episode, frame) = (self.run.episode, stamp.sequence as usize);
        let parts = (0..episode.sensors)
            .map(|sensor| episode.sensed(frame, sensor))
            .collect::<Result<Vec<_>, _>>()?;
        let mut bytes = Vec::new();
        encode_frame(stamp, &parts, |more| bytes.extend_from_slice(more));
        let words: Vec<u32> = bytes.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect();
        let number = stamp.sequence + 1;
        self.target.write(self.areas.0, &words)?;
        self.target.write(self.word(Word::Asked), &[number])?;
        let words = self.wait(Word::Answered, number)?.with_context(|| {
            format!("frame {frame}: the board does not answer for {} s", self.run.timeout.as_secs_f32())
        })?;
        self.refuse_failed(&words).with_context(|| format!("frame {frame}"))?;
        let mut header = [0; ANSWER_HEADER_WORDS];
        self.target.read(self.areas.1, &mut header)?;
        let length = answer_words(&header).with_context(|| {
            format!(
                "frame {frame}: the board's answer is longer than the {ANSWER_WORDS} words that it may have"
            )
        })?;
        let mut words = vec![0; length];
        self.target.read(self.areas.1, &mut words)?;
        Answer::decode(&words).with_context(|| format!("frame {frame}: the board's answer is not valid"))
    }
}

impl Report {
    fn compare(&mut self, frame: usize, expected: &[CanFrame], answer: &Answer) {
        let places = expected.len().max(answer.can.len());
        for place in 0..places {
            let (expected, found) = (expected.get(place), answer.can.get(place));
            if expected != found && self.first.len() < DESCRIBED_MAX {
                let text = |can: Option<&CanFrame>| can.map(|can| format!("{can:?}"));
                let (expected, found) = (text(expected), text(found));
                self.first.push(Difference { frame, can_frame: place, expected, found });
            }
        }
        self.differing_frames += usize::from(expected != answer.can);
        self.can_frames += places;
        if answer.step_cycles > self.worst_step_cycles {
            (self.worst_step_cycles, self.worst_step_frame) = (answer.step_cycles, frame);
        }
    }
}
