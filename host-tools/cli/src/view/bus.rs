//! Frames of a module on a bus, from a candump log that may still be growing.

use std::io::BufRead;

use slipsense::features::XlFrontEnd;
use slipsense::health;
use slipsense::params::MAX_SENSORS;
use slipsense::wire::{NodeId, RawMessage, Received, Receiver, SlipMessage};
use slipsense_recording::candump::{CandumpError, CandumpReader, Rule};

use super::record::{Record, SensorRecord};
use super::store::Store;

/// Puts messages of one frame together. A frame is whole when the next one's slip message comes.
struct Assembly {
    ears: [XlFrontEnd; MAX_SENSORS],
    open: Option<Record>,
    last_sequence: Option<u32>,
}

/// Put the frames of `node` into the store until the log ends.
///
/// Traffic of others is passed over, and damaged transfers cost their frame only. A line that is no line of a log
/// ends it, with its number and what is wrong.
pub fn run(log: impl BufRead, node: NodeId, store: &Store) -> Result<(), CandumpError> {
    let mut receiver = Receiver::new(node);
    let ears = std::array::from_fn(|_| XlFrontEnd::new());
    let mut assembly = Assembly { ears, open: None, last_sequence: None };
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
        let sensors = usize::from(slip.sensors);
        self.open = Some(Record { slip, lost, truth: None, sensors: vec![SensorRecord::default(); sensors] });
    }

    fn raw(&mut self, raw: RawMessage) {
        let Some(ear) = self.ears.get_mut(usize::from(raw.sensor)) else { return };
        let heard = raw.health & health::XL_MISSING == 0;
        if heard {
            ear.push(&raw.xl);
        } else {
            *ear = XlFrontEnd::new();
        }
        let open = self.open.as_mut().filter(|open| open.slip.sequence == raw.sequence);
        if let Some(sensor) = open.and_then(|open| open.sensors.get_mut(usize::from(raw.sensor))) {
            sensor.log_mel = heard.then(|| ear.log_mel());
            sensor.piezo = (raw.health & health::PIEZO_MISSING == 0).then_some(raw.piezo);
        }
    }
}
