//! Where frames come from: an episode through the pipeline, or the messages of a module in a candump log that may
//! still be growing.

use std::io::{BufRead, Read, Seek};
use std::iter;

use slipsense::features::XlFrontEnd;
use slipsense::health;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::SensorInput;
use slipsense::wire::{NodeId, Origin, RawMessage, Received, Receiver, Region, SlipMessage};
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};
use slipsense_recording::score::SLIP;
use slipsense_recording::{EpisodeReader, Problem};

use super::record::{Record, SensorRecord};

/// All frames of an episode, each read when it is asked for.
pub fn episode<'a, R: Read + Seek>(
    file: &'a mut EpisodeReader<R>,
    model: Model<'a>,
) -> Result<impl Iterator<Item = Result<Record, Problem>> + 'a, Problem> {
    let (episode, mut scans) = file.scans()?;
    let count = |error| Problem::Rule(format!("array `piezo`: {error}"));
    let mut pipeline = Box::new(Pipeline::new(model, episode.sensors).map_err(count)?);
    let frames = episode.xl_end.len() / episode.sensors;
    Ok((0..frames).map_while(move |frame| {
        let pads = match scans.by_ref().take(episode.sensors).collect::<Result<Vec<_>, _>>() {
            Ok(pads) => pads,
            Err(problem) => return Some(Err(problem)),
        };
        let inputs: [_; MAX_SENSORS] = std::array::from_fn(|sensor| match pads.get(sensor) {
            Some(pad) => SensorInput {
                piezo: Some(pad),
                xl: Some(episode.xl_batch(frame, sensor)),
                xl_end: episode.xl_end(frame, sensor),
            },
            None => SensorInput::default(),
        });
        let output = pipeline.step(&inputs[..episode.sensors]);
        let slip = output.slip_message(FrameStamp::of_recording(frame as u32), &Origin::default());
        let log_mel = output.log_mel.map(Some);
        let sensor = |(piezo, log_mel)| SensorRecord { piezo: Some(piezo), log_mel };
        Some(Ok(Record {
            logits: output.logits.map(|logit| logit.to_bits()),
            truth: episode.label.as_ref().map(|label| label[frame] == SLIP),
            sensors: pads.into_iter().zip(log_mel).map(sensor).collect(),
            ..Record::of_message(slip)
        }))
    }))
}

/// The frames of `node` in a log.
///
/// Traffic of other nodes is skipped, and a damaged transfer costs its frame only. A line that is not a line of a log
/// ends it, with its number and what is wrong.
pub fn log(log: impl BufRead, node: NodeId) -> impl Iterator<Item = Result<Record, CandumpError>> {
    let mut receiver = Receiver::new(node);
    let front_ends = std::array::from_fn(|_| (XlFrontEnd::new(), 0));
    let mut assembly = Assembly { front_ends, open: None, last_sequence: None };
    let (mut entries, mut error) = (Some(CandumpReader::new(log)), None);
    iter::from_fn(move || {
        while let Some(entry) = entries.as_mut().and_then(Iterator::next) {
            let entry = match entry {
                Ok(entry) => entry,
                Err(CandumpError { rule: Rule::NotOurs, .. }) => continue,
                Err(wrong) => {
                    error = Some(wrong);
                    break;
                }
            };
            match receiver.accept(&entry.frame) {
                Ok(Some(Received::Slip(slip))) => {
                    if let Some(whole) = assembly.slip(slip) {
                        return Some(Ok(whole));
                    }
                }
                Ok(Some(Received::Raw(raw))) => assembly.raw(raw),
                // A transfer that did not arrive whole shows as a frame without its taxels, or as a gap.
                Ok(None) | Err(_) => {}
            }
        }
        entries = None;
        assembly.open.take().map(Ok).or_else(|| error.take().map(Err))
    })
}

/// Puts messages of one frame together. A frame is whole when the next one's slip message comes.
struct Assembly {
    /// And the index of the sample that comes next.
    front_ends: [(XlFrontEnd, u32); MAX_SENSORS],
    open: Option<Record>,
    last_sequence: Option<u32>,
}

impl Assembly {
    /// Begins a frame; the one before is whole.
    fn slip(&mut self, slip: SlipMessage) -> Option<Record> {
        // A module that restarts begins at 0 again, which is no loss.
        let gap = self.last_sequence.map_or(0, |last| slip.sequence.wrapping_sub(last).wrapping_sub(1));
        let lost = if gap < u32::MAX / 2 { gap } else { 0 };
        self.last_sequence = Some(slip.sequence);
        self.open.replace(Record { lost, ..Record::of_message(slip) })
    }

    fn raw(&mut self, raw: RawMessage) {
        let index = usize::from(raw.sensor);
        let Some((front_end, next)) = self.front_ends.get_mut(index) else { return };
        let has_samples = raw.health & health::XL_MISSING == 0;
        // As the module does where samples are missing; here those as well that were lost or did not fit.
        if !has_samples || *next != raw.xl_end.wrapping_sub(raw.xl.len() as u32) {
            front_end.restart();
        }
        front_end.push(&raw.xl);
        *next = raw.xl_end;
        let open = self.open.as_mut().filter(|open| open.slip.sequence == raw.sequence);
        if let Some(sensor) = open.and_then(|open| open.sensors.get_mut(index)) {
            sensor.log_mel = has_samples.then(|| front_end.log_mel());
            sensor.piezo = (raw.known() != Region::NONE).then_some(raw.piezo);
        }
    }
}
