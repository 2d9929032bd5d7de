//! What is published of the traffic on a bus; node and bags publish the same.

use std::collections::BTreeMap;

use anyhow::Result;
use slipsense::wire::{NodeId, RawMessage, Received, Region, SlipMessage};
use slipsense_recording::candump::LogEntry;
use slipsense_recording::client::Reads;
use slipsense_recording::decode::{Decoder, calibration, heartbeat};

use crate::diagnostics;
use crate::messages::{Image, Info, Raw, RosMessage, Slip};
use crate::module::{Module, Second, mask_of};

pub const DIAGNOSTICS: &str = "/diagnostics";
/// Time between two arrays of diagnostics.
const DIAGNOSTICS_PERIOD_US: u64 = 1_000_000;

/// Where messages go.
pub trait Sink {
    fn put<M: RosMessage>(&mut self, topic: &str, message: M, time_us: u64) -> Result<()>;
}

pub struct Topics {
    namespace: String,
    pub decoder: Decoder,
    reads: Reads,
    pub modules: BTreeMap<NodeId, Module>,
    /// When diagnostics were last published.
    diagnostics_us: Option<u64>,
}

impl Topics {
    pub fn new(namespace: &str) -> Self {
        let (decoder, reads) = (Decoder::new(), Reads::default());
        let namespace = namespace.to_owned();
        Self { namespace, decoder, reads, modules: BTreeMap::new(), diagnostics_us: None }
    }

    /// The topic of a module.
    pub fn topic(&self, node: NodeId, what: &str) -> String {
        format!("{}/node{}/{what}", self.namespace, node.get())
    }

    /// The topic of a sensor.
    pub fn sensor_topic(&self, node: NodeId, sensor: u8, what: &str) -> String {
        self.topic(node, &format!("sensor{sensor}/{what}"))
    }

    /// Take a frame, and publish what it completes.
    pub fn entry(&mut self, entry: &LogEntry, sink: &mut impl Sink) -> Result<()> {
        let LogEntry { frame, timestamp_us, .. } = entry;
        let time_us = *timestamp_us;
        if let Some((node, said)) = heartbeat(frame) {
            self.modules.entry(node).or_default().heartbeat = Some(said);
        } else if let Some((node, sensor, said)) = calibration(frame) {
            self.modules.entry(node).or_default().sensors[sensor].calibration = Some(said.to_owned());
        } else if let Some((node, register, rows)) = self.reads.accept(frame, time_us) {
            if let Some((sensor, mask)) = mask_of(&register, &rows) {
                self.modules.entry(node).or_default().sensors[sensor].mask = Some(mask);
            }
        } else if let Some(decoded) = self.decoder.accept(frame) {
            match decoded.message {
                Received::Slip(message) => self.slip(decoded.node, &message, time_us, sink)?,
                Received::Raw(message) => self.raw(decoded.node, &message, time_us, sink)?,
            }
        }
        self.tick(time_us, sink)
    }

    fn slip(
        &mut self,
        node: NodeId,
        message: &SlipMessage,
        time_us: u64,
        sink: &mut impl Sink,
    ) -> Result<()> {
        let module = self.modules.entry(node).or_default();
        module.accept(message);
        let news = module.news();
        sink.put(&self.topic(node, "slip"), Slip::new(node, message, time_us), time_us)?;
        match news {
            Some((configuration, sensors)) => {
                let info = Info::new(node, configuration, sensors, time_us);
                sink.put(&self.topic(node, "info"), info, time_us)
            }
            None => Ok(()),
        }
    }

    fn raw(&mut self, node: NodeId, message: &RawMessage, time_us: u64, sink: &mut impl Sink) -> Result<()> {
        let topic = |what| self.sensor_topic(node, message.sensor, what);
        sink.put(&topic("raw"), Raw::new(node, message, time_us), time_us)?;
        if message.known() != Region::NONE {
            sink.put(&topic("counts"), Image::counts(node, message, time_us), time_us)?;
        }
        let topic = topic("pressure");
        let (module, sensor) = (self.modules.entry(node).or_default(), usize::from(message.sensor));
        module.second.raw_messages[sensor] += 1;
        match module.mask(sensor).filter(|_| module.is_calibrated(sensor)) {
            Some(mask) => sink.put(&topic, Image::pressure(node, message, &mask, time_us), time_us),
            None => Ok(()),
        }
    }

    /// Publish diagnostics where a second has passed.
    pub fn tick(&mut self, time_us: u64, sink: &mut impl Sink) -> Result<()> {
        // The clock of a computer may go back.
        let since = time_us.abs_diff(*self.diagnostics_us.get_or_insert(time_us));
        if since < DIAGNOSTICS_PERIOD_US || self.modules.is_empty() {
            return Ok(());
        }
        self.diagnostics_us = Some(time_us);
        let array = diagnostics::array(&self.modules, &self.decoder.counts(), time_us);
        self.modules.values_mut().for_each(|module| module.second = Second::default());
        sink.put(DIAGNOSTICS, array, time_us)
    }
}

/// A name of ROS from the root: `/` and words of letters, digits and single underscores.
pub fn namespace(text: &str) -> Result<String, String> {
    let word = |word: &str| {
        word.starts_with(|c: char| c.is_ascii_alphabetic())
            && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
            && !word.contains("__")
    };
    match text.strip_prefix('/') {
        Some(words) if words.split('/').all(word) => Ok(text.to_owned()),
        _ => Err("must be /NAME or /NAME/NAME, of letters, digits and single underscores".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use slipsense::sensor::{PiezoFrame, SensorInput};
    use slipsense::wire::{CanFrame, Detail, RawBuffer, RawForm, RawFrame, Transmitter};

    use super::*;

    impl Sink for Vec<(String, serde_json::Value)> {
        fn put<M: RosMessage>(&mut self, topic: &str, message: M, _: u64) -> Result<()> {
            self.push((topic.to_owned(), serde_json::to_value(message)?));
            Ok(())
        }
    }

    fn entry(frame: CanFrame) -> LogEntry {
        LogEntry { timestamp_us: 10_000_000, interface: "can0".to_owned(), frame }
    }

    #[test]
    fn a_taxel_that_was_not_sent_is_no_number() {
        let (mut topics, mut transmitter) = (Topics::new("/s"), Transmitter::new(NodeId::DEFAULT));
        let mut counts = [1; 1024];
        counts[16 * 32 + 5..16 * 32 + 20].fill(500);
        let piezo = PiezoFrame::from_scan(counts);
        let slip = transmitter.slip(&SlipMessage { sensors: 1, ..SlipMessage::default() });
        topics.entry(&entry(slip), &mut vec![]).unwrap();
        for (detail, taxels) in [(Detail::All, 942), (Detail::Contact, 15), (Detail::Accelerometer, 0)] {
            let input = SensorInput { piezo: Some(&piezo), xl: Some(&[]), xl_end: 0 };
            let raw = RawFrame { timestamp_us: 0, sequence: 0, sensor: 0, health: 0, input };
            let (mut said, mut buffer) = (Vec::new(), RawBuffer::new());
            for frame in transmitter.raw_as(RawForm::Compressed(detail), &raw, &mut buffer) {
                topics.entry(&entry(frame), &mut said).unwrap();
            }
            let image =
                |name: &str| said.iter().find(|(topic, _)| topic == &format!("/s/node42/sensor0/{name}"));
            assert_eq!(image("counts").is_some(), taxels > 0, "{detail:?}");
            let data = image("pressure").unwrap().1["data"].as_array().unwrap();
            let bytes: Vec<u8> = data.iter().map(|byte| byte.as_u64().unwrap() as u8).collect();
            let kpa = bytes.as_chunks().0.iter().map(|&four| f32::from_le_bytes(four));
            assert_eq!(kpa.filter(|kpa| !kpa.is_nan()).count(), taxels, "{detail:?}");
        }
    }

    #[test]
    fn diagnostics_go_on_where_the_clock_goes_back() {
        let (mut topics, mut said) = (Topics::new("/s"), Vec::new());
        let slip = Transmitter::new(NodeId::DEFAULT).slip(&SlipMessage::default());
        topics.entry(&entry(slip), &mut said).unwrap();
        for us in [2_000_000, 2_500_000, 3_000_000] {
            topics.tick(us, &mut said).unwrap();
        }
        assert_eq!(said.iter().filter(|(topic, _)| topic == DIAGNOSTICS).count(), 2);
    }
}
