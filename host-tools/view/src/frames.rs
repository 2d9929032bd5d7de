//! The frames of a session, in order: a source fills it, a page reads it.

use std::collections::VecDeque;
use std::io::{Read, Write};

use flate2::Compression;
use flate2::read::ZlibDecoder;
use flate2::write::ZlibEncoder;
use serde::Serialize;
use slipsense::params::{COL_PITCH_MM, FRAME_RATE_HZ, MAX_SENSORS, MEL_BINS, ROW_PITCH_MM};
use slipsense_recording::film::PRESSURE_KPA;
use slipsense_recording::{DEGRADED, Episode, HEALTH, INVALID, mel_point_hz};

use super::record::{self, Record};

/// Frames that are packed, dropped and asked for together: a second.
pub const CHUNK: usize = FRAME_RATE_HZ as usize;

/// What does not change while a source runs.
#[derive(Clone, Debug, Serialize)]
pub struct Session {
    /// Different after a restart, so that a page knows to start over.
    pub id: u64,
    pub name: String,
    /// The network that runs; `None`: the module's own decisions are shown.
    pub model: Option<String>,
    /// Are the data generated? `None`: unknown.
    pub synthetic: Option<bool>,
    /// Acceleration of one LSB, g; `None`: unknown.
    pub xl_lsb_g: Option<f64>,
    pub sensors: usize,
    /// Does it go on by itself? Then the page follows the newest frame.
    pub live: bool,
}

impl Session {
    /// Of a log, whose first message says how many sensors there are.
    pub fn of_log(name: String, live: bool) -> Self {
        Self { id: 0, name, model: None, synthetic: None, xl_lsb_g: None, sensors: MAX_SENSORS, live }
    }

    /// Of an episode through a model of this name.
    pub fn of_episode(name: String, model: String, episode: &Episode) -> Self {
        Self {
            model: Some(model),
            synthetic: Some(episode.meta.is_synthetic()),
            xl_lsb_g: Some(episode.meta.xl_lsb_g),
            sensors: episode.sensors,
            ..Self::of_log(name, false)
        }
    }
}

#[derive(Clone, Debug, Serialize)]
pub struct State {
    #[serde(flatten)]
    pub session: Session,
    pub record_bytes: usize,
    pub frame_rate_hz: u32,
    pub chunk: usize,
    /// Centre of each bin of the log-mel, Hz.
    pub mel_hz: [f64; MEL_BINS],
    pub taxel_mm2: f32,
    /// Number of the oldest frame still stored, counted from the first received.
    pub first: u64,
    pub end: u64,
    pub ended: bool,
    /// Frames lost so far, by their sequence numbers.
    pub lost: u64,
    /// Why the source stopped early, if it did.
    pub problem: Option<String>,
    /// Names of the bits of a sensor's health, of what makes slip invalid, of what makes it worse.
    pub health: [(u8, &'static str); HEALTH.len()],
    pub invalid: [(u8, &'static str); INVALID.len()],
    pub degraded: [(u8, &'static str); DEGRADED.len()],
    /// Bits of health that are no fault.
    pub no_fault: u8,
}

pub struct Answer {
    /// Number of the first frame in the body, if it holds frames.
    pub first: Option<u64>,
    pub body: Vec<u8>,
}

/// Records, a second at a time packed: an hour of three sensors is 5.4 GB plain.
pub struct Frames {
    packed: VecDeque<Vec<u8>>,
    /// Records of the second that is not whole yet.
    open: Vec<u8>,
    marks: VecDeque<u8>,
    state: State,
    chunks_max: usize,
}

impl Frames {
    /// Keeps the last `capacity` frames, in whole seconds.
    pub fn new(session: Session, capacity: usize) -> Self {
        let state = State {
            record_bytes: record::bytes(session.sensors),
            frame_rate_hz: FRAME_RATE_HZ,
            chunk: CHUNK,
            mel_hz: std::array::from_fn(|bin| mel_point_hz(bin + 1, MEL_BINS)),
            taxel_mm2: COL_PITCH_MM * ROW_PITCH_MM,
            first: 0,
            end: 0,
            ended: false,
            lost: 0,
            problem: None,
            health: HEALTH,
            invalid: INVALID,
            degraded: DEGRADED,
            no_fault: record::NO_FAULT,
            session,
        };
        let chunks_max = capacity.div_ceil(CHUNK).max(1);
        Self { packed: VecDeque::new(), open: Vec::new(), marks: VecDeque::new(), state, chunks_max }
    }

    pub fn push(&mut self, record: &Record) {
        record.encode(self.state.session.sensors, &mut self.open);
        self.marks.push_back(record.mark());
        self.state.end += 1;
        self.state.lost += u64::from(record.lost);
        if self.open.len() < CHUNK * self.state.record_bytes {
            return;
        }
        self.packed.push_back(packed(&self.open));
        self.open.clear();
        if self.packed.len() > self.chunks_max {
            self.packed.pop_front();
            self.marks.drain(..CHUNK);
            self.state.first += CHUNK as u64;
        }
    }

    /// There will be no more frames; `problem`: what went wrong.
    pub fn end(&mut self, problem: Option<String>) {
        self.state.ended = true;
        let nothing =
            || (self.state.end == 0).then(|| "no frame to show: no message of this module".to_owned());
        self.state.problem = problem.or_else(nothing);
    }

    pub fn state(&self) -> &State {
        &self.state
    }

    /// What the page asks for:
    ///
    /// | request | answer |
    /// |---|---|
    /// | `state` | [`State`] as JSON |
    /// | `records?from=N` | records from frame N on, to the end of its second |
    /// | `marks?from=N` | one byte per frame from N on, see [`Record::mark`] |
    /// | `kpa` | pressure of each count by the nominal film, 32-bit floats |
    ///
    /// Where the frame is not stored any more, the answer begins with the oldest that is. `None`: no such request.
    pub fn answer(&self, request: &str) -> Option<Answer> {
        let plain = |body| Some(Answer { first: None, body });
        match request {
            "state" => return plain(serde_json::to_vec(&self.state).unwrap_or_default()),
            "kpa" => return plain(PRESSURE_KPA.iter().flat_map(|kpa| kpa.to_le_bytes()).collect()),
            _ => {}
        }
        let (what, from) = request.split_once("?from=")?;
        let from = from.parse::<u64>().ok()?.clamp(self.state.first, self.state.end);
        let start = (from - self.state.first) as usize;
        let body = match what {
            "marks" => self.marks.range(start..).copied().collect(),
            "records" => match self.packed.get(start / CHUNK) {
                Some(packed) => unpacked(packed).split_off(start % CHUNK * self.state.record_bytes),
                None => self.open[start % CHUNK * self.state.record_bytes..].to_vec(),
            },
            _ => return None,
        };
        Some(Answer { first: Some(from), body })
    }
}

fn packed(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
    // Writing to memory does not fail, nor does reading back what it wrote.
    let _ = encoder.write_all(bytes);
    encoder.finish().unwrap_or_default()
}

fn unpacked(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    let _ = ZlibDecoder::new(bytes).read_to_end(&mut out);
    out
}
