//! Frames to be run, wherever they come from, in the form in which the tasks pass them on.

use anyhow::Result;
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorReadings;
use slipsense::wire::NodeId;
use slipsense_qemu::input::Header;
use slipsense_recording::Episode;

pub struct Frames {
    pub compress_raw: bool,
    pub sensors: usize,
    /// Each with a part for every sensor.
    pub list: Vec<(FrameStamp, Vec<SensorReadings>)>,
}

impl Frames {
    pub fn new(sensors: usize, list: Vec<(FrameStamp, Vec<SensorReadings>)>) -> Self {
        Self { compress_raw: false, sensors, list }
    }

    pub fn from_episode(episode: &Episode, limit: Option<u32>) -> Result<Self> {
        let count = limit.map_or(usize::MAX, |limit| limit as usize).min(episode.frames());
        let frame = |frame| {
            let parts = (0..episode.sensors).map(|sensor| episode.sensed(frame, sensor));
            Ok((FrameStamp::of_recording(u32::try_from(frame)?), parts.collect::<Result<_, _>>()?))
        };
        Ok(Self::new(episode.sensors, (0..count).map(frame).collect::<Result<_>>()?))
    }

    /// Of the file with these frames and this model.
    pub fn header(&self, model: &[u8]) -> Result<Header> {
        Ok(Header {
            model_bytes: u32::try_from(model.len())?,
            sensors: u32::try_from(self.sensors)?,
            frames: u32::try_from(self.list.len())?,
            node: NodeId::DEFAULT,
            compress_raw: self.compress_raw,
        })
    }
}
