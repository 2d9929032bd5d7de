//! Pipeline and wire from samples to CAN frames, and the output file: one record per frame, with every result.

use bytemuck::bytes_of;
use heapless::Vec;
use slipsense::board::replay::CAN_FRAMES_MAX;
use slipsense::features::LogMel;
use slipsense::fixed::Logit;
use slipsense::net::Model;
use slipsense::params::{CLASSES, MAX_SENSORS};
use slipsense::pipeline::{FrameStamp, Output, Pipeline, SensorCountError};
use slipsense::sensor::{SensorInput, SensorReadings};
use slipsense::wire::{CanFrame, Detail, Origin, RawForm, RawTransfer, Transmitter};

use crate::bytes::Reader;
use crate::input::Header;

/// Bytes of the largest record.
pub const RECORD_BYTES_MAX: usize = 512 + CAN_FRAMES_MAX * 69;

/// What turns a frame into its record, on the emulated core and on this computer: without tasks or queues.
pub struct SignalPath<'m> {
    pipeline: Pipeline<'m>,
    transmitter: Transmitter,
    form: RawForm,
    raw: RawTransfer,
}

impl<'m> SignalPath<'m> {
    pub fn new(header: &Header, model: Model<'m>) -> Result<Self, SensorCountError> {
        Ok(Self {
            pipeline: Pipeline::new(model, header.sensors as usize)?,
            transmitter: Transmitter::new(header.node),
            form: if header.compress_raw { RawForm::Compressed(Detail::All) } else { RawForm::Plain },
            raw: RawTransfer::new(),
        })
    }

    /// `count` calls what it is given and returns how many instructions that took.
    pub fn record(
        &mut self,
        stamp: FrameStamp,
        parts: &[SensorReadings],
        count: impl FnOnce(&mut dyn FnMut()) -> u32,
    ) -> Record {
        let mut inputs = [SensorInput::default(); MAX_SENSORS];
        inputs.iter_mut().zip(parts).for_each(|(input, part)| *input = part.input());
        let mut output = None;
        let instructions = count(&mut || output = Some(self.pipeline.step(&inputs[..parts.len()])));
        let output = output.expect("the step was called");
        let mut record = Record { instructions, ..Record::new(stamp.sequence, &output) };
        let mut send = |frame| record.can.push(frame).expect("the record has room for every CAN frame");
        send(self.transmitter.slip(&output.slip_message(stamp, &Origin::default())));
        for (sensor, part) in parts.iter().enumerate() {
            let raw = output.raw_frame(stamp, sensor, part.input());
            if self.transmitter.start_raw(self.form, &raw, &mut self.raw) {
                core::iter::from_fn(|| self.raw.next_frame()).for_each(&mut send);
            }
        }
        record
    }
}

/// Everything that one frame led to. Entries of sensors that are not in use are zero.
#[derive(Clone, Debug, Default)]
pub struct Record {
    pub sequence: u32,
    /// Of the pipeline on the emulated core; 0 on this computer.
    pub instructions: u32,
    /// Features per sensor.
    pub log_mel: [LogMel; MAX_SENSORS],
    pub logits: [Logit; CLASSES],
    pub class: u8,
    /// The flag of the class.
    pub may_begin: bool,
    /// The flag to act on.
    pub slip: bool,
    /// Health bits per sensor.
    pub health: [u8; MAX_SENSORS],
    /// What went onto the bus, in order.
    pub can: Vec<CanFrame, CAN_FRAMES_MAX>,
}

impl Record {
    pub fn new(sequence: u32, output: &Output) -> Self {
        Self {
            sequence,
            instructions: 0,
            log_mel: output.log_mel,
            logits: output.logits,
            class: output.class as u8,
            may_begin: output.may_begin,
            slip: output.slip,
            health: output.health.map(|health| health.0),
            can: Vec::new(),
        }
    }

    pub fn encode(&self, mut put: impl FnMut(&[u8])) {
        put(bytes_of(&[self.sequence, self.instructions]));
        for log_mel in &self.log_mel {
            put(bytes_of(&log_mel.ln_power));
            put(bytes_of(&log_mel.standardised));
            put(bytes_of(&log_mel.over_floor));
        }
        put(bytes_of(&self.logits.map(Logit::to_bits)));
        put(&[self.class, u8::from(self.may_begin), u8::from(self.slip)]);
        put(&self.health);
        put(bytes_of(&(self.can.len() as u16)));
        for frame in &self.can {
            put(bytes_of(&frame.id()));
            put(&[frame.data().len() as u8]);
            put(frame.data());
        }
    }

    /// Take one record off the front of `bytes`; `None` if they end inside it or are no record.
    pub fn decode(bytes: &mut &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        let [sequence, instructions] = reader.next()?;
        let mut record = Self { sequence, instructions, ..Self::default() };
        for log_mel in &mut record.log_mel {
            let (ln_power, standardised) = (reader.next()?, reader.next()?);
            *log_mel = LogMel { ln_power, standardised, over_floor: reader.next()? };
        }
        record.logits = reader.next::<[i32; CLASSES]>()?.map(Logit::from_bits);
        let [class, may_begin, slip] = reader.next()?;
        (record.class, record.may_begin, record.slip) = (class, may_begin != 0, slip != 0);
        record.health = reader.next()?;
        for _ in 0..reader.next::<u16>()? {
            let (id, length): (u32, u8) = (reader.next()?, reader.next()?);
            record.can.push(CanFrame::new(id, reader.take(length.into())?).ok()?).ok()?;
        }
        *bytes = reader.0;
        Some(record)
    }
}
