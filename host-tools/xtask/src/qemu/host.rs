//! What this computer makes of the frames: pipeline and wire called directly, without tasks or queue.

use std::time::{Duration, Instant};

use anyhow::Result;
use slipsense::net::Model;
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::SensorInput;
use slipsense::wire::{Detail, NodeId, RawBuffer, RawForm, Transmitter};
use slipsense_qemu::record::Record;

use super::frames::Frames;

/// Who speaks on the bus.
pub const NODE: NodeId = NodeId::DEFAULT;

/// One record per frame, and the time that it took.
pub fn records(frames: &Frames, model: &[u8]) -> Result<(Vec<Record>, Duration)> {
    let start = Instant::now();
    let mut records = Vec::with_capacity(frames.len());
    each_record(frames, model, |_, record| {
        records.push(record);
        Ok(())
    })?;
    Ok((records, start.elapsed()))
}

/// Show `each` the record of every frame, in order.
pub fn each_record(
    frames: &Frames,
    model: &[u8],
    mut each: impl FnMut(FrameStamp, Record) -> Result<()>,
) -> Result<()> {
    let mut pipeline = Pipeline::new(Model::parse(model)?, frames.sensors())?;
    let mut transmitter = Transmitter::new(NODE);
    let mut buffer = RawBuffer::new();
    let form = if frames.compress_raw { RawForm::Compressed(Detail::All) } else { RawForm::Plain };
    for (stamp, parts) in frames.iter() {
        let inputs: Vec<SensorInput<'_>> = parts.iter().map(|part| part.input()).collect();
        let output = pipeline.step(&inputs);
        let mut record = Record::new(stamp.sequence, &output);
        let mut send = |frame| record.can.push(frame).expect("the record has room for every CAN frame");
        send(transmitter.slip(&output.slip_message(stamp, 0)));
        for (sensor, part) in parts.iter().enumerate() {
            let raw = output.raw_frame(stamp, sensor, part.input(), part.xl_end);
            transmitter.raw_as(form, &raw, &mut buffer).for_each(&mut send);
        }
        each(stamp, record)?;
    }
    Ok(())
}
