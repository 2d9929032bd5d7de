//! Where frames come from: an episode through the pipeline, or the messages of a module in a candump log that may
//! still be growing.

use std::io::BufRead;

use slipsense::features::XlFrontEnd;
use slipsense::health;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense::pipeline::{FrameStamp, Pipeline, SensorCountError};
use slipsense::wire::{NodeId, Origin, RawMessage, Received, Receiver, SlipMessage};
use slipsense_recording::Episode;
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};
use slipsense_recording::score::SLIP;

use super::record::{Record, SensorRecord};
use super::store::Store;

/// Put all frames into the store, as fast as they come.
pub fn run_episode(episode: &Episode, model: Model<'_>, store: &Store) -> Result<(), SensorCountError> {
    let mut pipeline = Pipeline::new(model, episode.sensors)?;
    for frame in 0..episode.frames() {
        let output = pipeline.step(&episode.inputs(frame)[..episode.sensors]);
        let sensor = |sensor: usize| SensorRecord {
            piezo: Some(episode.piezo(frame, sensor).clone()),
            log_mel: Some(output.log_mel[sensor]),
        };
        store.push(&Record {
            slip: output.slip_message(FrameStamp::of_recording(frame as u32), &Origin::default()),
            lost: 0,
            truth: episode.label.as_ref().map(|label| label[frame] == SLIP),
            sensors: (0..episode.sensors).map(sensor).collect(),
        });
    }
    Ok(())
}

/// Put the frames of `node` into the store until the log ends.
///
/// Traffic of other nodes is skipped, and a damaged transfer costs its frame only. A line that is not a line of a log
/// ends it, with its number and what is wrong.
pub fn run_log(log: impl BufRead, node: NodeId, store: &Store) -> Result<(), CandumpError> {
    let mut receiver = Receiver::new(node);
    let front_ends = std::array::from_fn(|_| XlFrontEnd::new());
    let mut assembly = Assembly { front_ends, open: None, last_sequence: None };
    let mut ended = Ok(());
    for entry in CandumpReader::new(log) {
        let entry = match entry {
            Ok(entry) => entry,
            Err(CandumpError { rule: Rule::NotOurs, .. }) => continue,
            Err(error) => {
                ended = Err(error);
                break;
            }
        };
        match receiver.accept(&entry.frame) {
            Ok(Some(Received::Slip(slip))) => assembly.slip(slip, store),
            Ok(Some(Received::Raw(raw))) => assembly.raw(raw),
            // A transfer that did not arrive whole shows as a frame without its taxels, or as a gap.
            Ok(None) | Err(_) => {}
        }
    }
    assembly.close(store);
    ended
}

/// Puts messages of one frame together. A frame is whole when the next one's slip message comes.
struct Assembly {
    front_ends: [XlFrontEnd; MAX_SENSORS],
    open: Option<Record>,
    last_sequence: Option<u32>,
}

impl Assembly {
    fn close(&mut self, store: &Store) {
        if let Some(record) = self.open.take() {
            store.push(&record);
        }
    }

    fn slip(&mut self, slip: SlipMessage, store: &Store) {
        self.close(store);
        // A module that restarts begins at 0 again, which is no loss.
        let gap = self.last_sequence.map_or(0, |last| slip.sequence.wrapping_sub(last).wrapping_sub(1));
        let lost = if gap < u32::MAX / 2 { gap } else { 0 };
        self.last_sequence = Some(slip.sequence);
        let sensors = vec![SensorRecord::default(); slip.sensors.into()];
        self.open = Some(Record { slip, lost, truth: None, sensors });
    }

    fn raw(&mut self, raw: RawMessage) {
        let index = usize::from(raw.sensor);
        let Some(front_end) = self.front_ends.get_mut(index) else { return };
        let has_samples = raw.health & health::XL_MISSING == 0;
        if has_samples {
            front_end.push(&raw.xl);
        } else {
            *front_end = XlFrontEnd::new();
        }
        let open = self.open.as_mut().filter(|open| open.slip.sequence == raw.sequence);
        if let Some(sensor) = open.and_then(|open| open.sensors.get_mut(index)) {
            sensor.log_mel = has_samples.then(|| front_end.log_mel());
            sensor.piezo = (raw.health & health::PIEZO_MISSING == 0).then_some(raw.piezo);
        }
    }
}
