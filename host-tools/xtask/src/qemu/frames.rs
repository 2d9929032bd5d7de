//! Frames to be run, wherever they come from, in the form in which the tasks pass them on.

use anyhow::Result;
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::SensorReadings;
use slipsense::wire::NodeId;
use slipsense_recording::Episode;

/// The emulated node's identifier.
pub const NODE: NodeId = NodeId::DEFAULT;

pub struct Frames {
    pub compress_raw: bool,
    sensors: usize,
    stamps: Vec<FrameStamp>,
    parts: Vec<SensorReadings>,
}

impl Frames {
    /// None yet.
    pub fn new(sensors: usize) -> Self {
        Self { compress_raw: false, sensors, stamps: Vec::new(), parts: Vec::new() }
    }

    pub fn from_episode(episode: &Episode, limit: Option<u32>) -> Result<Self> {
        let mut frames = Self::new(episode.sensors);
        let limit = limit.map_or(usize::MAX, |limit| limit as usize);
        for frame in 0..episode.frames().min(limit) {
            let stamp = FrameStamp::of_recording(u32::try_from(frame)?);
            let parts = (0..episode.sensors).map(|sensor| episode.sensed(frame, sensor));
            frames.push(stamp, parts.collect::<Result<Vec<_>, _>>()?);
        }
        Ok(frames)
    }

    pub fn push(&mut self, stamp: FrameStamp, parts: Vec<SensorReadings>) {
        assert_eq!(parts.len(), self.sensors, "one part per sensor");
        self.stamps.push(stamp);
        self.parts.extend(parts);
    }

    pub fn sensors(&self) -> usize {
        self.sensors
    }

    pub fn len(&self) -> usize {
        self.stamps.len()
    }

    pub fn is_empty(&self) -> bool {
        self.stamps.is_empty()
    }

    pub fn iter(&self) -> impl Iterator<Item = (FrameStamp, &[SensorReadings])> {
        self.stamps.iter().copied().zip(self.parts.chunks_exact(self.sensors))
    }
}
