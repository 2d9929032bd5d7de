//! What this computer makes of the frames: pipeline and wire called directly, without tasks or queue.

use anyhow::Result;
use slipsense::net::Model;
use slipsense::pipeline::{FrameStamp, Pipeline};
use slipsense::sensor::SensorInput;
use slipsense::wire::{Detail, Origin, RawBuffer, RawForm, Transmitter};
use slipsense_qemu::record::Record;

use super::frames::{Frames, NODE};

pub fn records<'a>(
    frames: &'a Frames,
    model: &'a [u8],
) -> Result<impl Iterator<Item = (FrameStamp, Record)> + 'a> {
    let mut pipeline = Pipeline::new(Model::parse(model)?, frames.sensors)?;
    let mut transmitter = Transmitter::new(NODE);
    let mut buffer = RawBuffer::new();
    let form = if frames.compress_raw { RawForm::Compressed(Detail::All) } else { RawForm::Plain };
    Ok(frames.list.iter().map(move |&(stamp, ref parts)| {
        let inputs: Vec<SensorInput<'_>> = parts.iter().map(|part| part.input()).collect();
        let output = pipeline.step(&inputs);
        let mut record = Record::new(stamp.sequence, &output);
        let mut send = |frame| record.can.push(frame).expect("the record has room for every CAN frame");
        send(transmitter.slip(&output.slip_message(stamp, &Origin::default())));
        for (sensor, part) in parts.iter().enumerate() {
            let raw = output.raw_frame(stamp, sensor, part.input());
            transmitter.raw_as(form, &raw, &mut buffer).for_each(&mut send);
        }
        (stamp, record)
    }))
}
