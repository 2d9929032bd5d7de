//! Sensor data of one frame in, one decision out: what firmware, simulator, replay and tests all call.
//!
//! A pure function of its inputs and its state: no clock, no I/O, no logging. It never fails; what is
//! missing or doubtful is flagged and left out, the rest goes on.

use core::borrow::BorrowMut;

use crate::contact::ContactSummary;
use crate::decision::{Decision, margin};
use crate::features::{LogMel, XlFrontEnd};
use crate::fixed::Logit;
use crate::health::{self, SensorHealth};
use crate::net::format::OperatingPoint;
use crate::net::{Model, NetworkState, SensorFeatures};
use crate::params::{CLASSES, CONTACT_SUM_MIN, FRAME_RATE_HZ, MAX_SENSORS, XL_WINDOW};
use crate::sensor::{SensorInput, XlSample};
use crate::wire::{RAW_XL_MAX, RawFrame, SensorContact, SlipMessage};

pub use crate::decision::Class;

/// Number and time of the tick that closed a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrameStamp {
    /// Counts frames, wraps.
    pub sequence: u32,
    /// Microseconds of the board's clock, below 2^56.
    pub timestamp_us: u64,
}

impl FrameStamp {
    /// The stamp of a frame of a recording, whose ticks are exactly 240 Hz from time 0 on; microseconds
    /// are rounded down.
    pub const fn of_recording(sequence: u32) -> Self {
        Self { sequence, timestamp_us: sequence as u64 * 1_000_000 / FRAME_RATE_HZ as u64 }
    }
}

/// The result of one frame. Entries of sensors beyond `sensors` are zero.
#[derive(Clone, Copy, Debug)]
pub struct Output {
    /// The decision frame by frame.
    pub class: Class,
    /// The network's outputs for the three classes.
    pub logits: [Logit; CLASSES],
    /// The flag: `class` is [`Class::Slip`].
    pub slip: bool,
    /// How far slip leads; `None` where no pad is touched. See [`margin`].
    pub margin: Option<Logit>,
    /// The flag to act on: slip by the model's operating point.
    pub alarm: bool,
    /// Sensors in use.
    pub sensors: usize,
    /// The contact on each pad; zero for a missing one.
    pub contact: [ContactSummary; MAX_SENSORS],
    /// Features of each accelerometer; zero for a missing one.
    pub log_mel: [LogMel; MAX_SENSORS],
    /// What was wrong with each sensor.
    pub health: [SensorHealth; MAX_SENSORS],
}

impl Output {
    /// The message that carries this result. `late_frames` is counted by who calls [`Pipeline::step`].
    pub fn slip_message(&self, stamp: FrameStamp, late_frames: u16) -> SlipMessage {
        let mut contact = [SensorContact::default(); MAX_SENSORS];
        for ((to, from), health) in contact.iter_mut().zip(&self.contact).zip(&self.health) {
            *to = SensorContact {
                health: health.0,
                sum: from.sum,
                area: from.area,
                centroid_row: from.centroid_row,
                centroid_col: from.centroid_col,
                axis_deg: from.axis_deg,
                elongation: from.elongation,
            };
        }
        SlipMessage {
            timestamp_us: stamp.timestamp_us,
            sequence: stamp.sequence,
            class: self.class as u8,
            slip: self.slip,
            alarm: self.alarm,
            logits: self.logits,
            late_frames,
            sensors: self.sensors as u8,
            contact,
        }
    }

    /// The raw frame of one sensor: what the pipeline was given, and what it thought of it.
    pub fn raw_frame<'a>(
        &self,
        stamp: FrameStamp,
        sensor: usize,
        input: SensorInput<'a>,
        xl_end: u32,
    ) -> RawFrame<'a> {
        RawFrame {
            timestamp_us: stamp.timestamp_us,
            sequence: stamp.sequence,
            sensor: sensor as u8,
            health: self.health.get(sensor).copied().unwrap_or_default().0,
            input,
            xl_end,
        }
    }
}

/// A number of sensors that a board cannot have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SensorCountError {
    /// What was asked for; 1 to [`MAX_SENSORS`] are possible.
    pub sensors: usize,
}

impl core::fmt::Display for SensorCountError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} sensors, 1 to {MAX_SENSORS} are possible", self.sensors)
    }
}

impl core::error::Error for SensorCountError {}

/// One accelerometer's front end and how much it has heard.
#[derive(Clone, Debug)]
struct Ear {
    front_end: XlFrontEnd,
    /// Samples since the start or the last gap, up to a full window.
    heard: usize,
}

impl Ear {
    const fn new() -> Self {
        Self { front_end: XlFrontEnd::new(), heard: 0 }
    }

    fn listen(&mut self, samples: &[XlSample]) -> LogMel {
        self.front_end.push(samples);
        self.heard = self.heard.saturating_add(samples.len()).min(XL_WINDOW);
        self.front_end.log_mel()
    }
}

/// All that is remembered between raw samples and decision, whatever the model and the sensors: key and value
/// caches, feature maps, averages of the taxels, filters. All of it starts as zeros, so that a microcontroller makes
/// it where it is to stay.
#[derive(Clone, Debug)]
pub struct State {
    ears: [Ear; MAX_SENSORS],
    network: NetworkState,
}

impl State {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self { ears: [const { Ear::new() }; MAX_SENSORS], network: NetworkState::new() }
    }
}

impl Default for State {
    fn default() -> Self {
        Self::new()
    }
}

/// The signal path of one module. It owns its state, or works on one that lies elsewhere.
#[derive(Clone, Debug)]
pub struct Pipeline<'m, S = State> {
    sensors: usize,
    model: Model<'m>,
    state: S,
    decision: Decision,
}

/// The RAM that a pipeline takes, whatever the model.
pub const PIPELINE_BYTES_MAX: usize = 100_000;
const _: () = assert!(size_of::<Pipeline<'static>>() <= PIPELINE_BYTES_MAX);

impl<'m> Pipeline<'m> {
    /// Before the first frame, for 1 to [`MAX_SENSORS`] sensors.
    pub const fn new(model: Model<'m>, sensors: usize) -> Result<Self, SensorCountError> {
        if sensors == 0 || sensors > MAX_SENSORS {
            return Err(SensorCountError { sensors });
        }
        let decision = Decision::new(model.point);
        Ok(Self { sensors, model, state: State::new(), decision })
    }
}

impl<'m, S: BorrowMut<State>> Pipeline<'m, S> {
    /// As [`Pipeline::new`], on a state as it is at first.
    pub fn within(state: S, model: Model<'m>, sensors: usize) -> Result<Self, SensorCountError> {
        if sensors == 0 || sensors > MAX_SENSORS {
            return Err(SensorCountError { sensors });
        }
        let decision = Decision::new(model.point);
        Ok(Self { sensors, model, state, decision })
    }

    /// Sensors in use.
    pub const fn sensors(&self) -> usize {
        self.sensors
    }

    /// The model in use.
    pub const fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// Raise the alarm at this operating point, one that [`OperatingPoint::check`] accepts; `None`: at the model's. A
    /// new point begins with nothing remembered.
    pub fn work_at(&mut self, point: Option<OperatingPoint>) {
        let point = point.unwrap_or(self.model.point);
        if self.decision.point() != point {
            self.decision = Decision::new(point);
        }
    }

    /// Samples of this accelerometer were lost before those of the next step: what was heard before the gap is
    /// forgotten, and the sensor warms up again. Of a sensor that is not there nothing is forgotten.
    pub fn forget_sound(&mut self, sensor: usize) {
        if let Some(ear) = self.state.borrow_mut().ears.get_mut(sensor) {
            *ear = Ear::new();
        }
    }

    /// Take one frame in. `inputs` in sensor order; one that is not there counts as missing, one too
    /// many is ignored.
    ///
    /// Never inlined, so that `cargo xtask stack` can look at all that it calls.
    #[inline(never)]
    pub fn step(&mut self, inputs: &[SensorInput<'_>]) -> Output {
        let mut output = Output {
            class: Class::NoContact,
            logits: [Logit::default(); CLASSES],
            slip: false,
            margin: None,
            alarm: false,
            sensors: self.sensors,
            contact: [ContactSummary::default(); MAX_SENSORS],
            log_mel: [LogMel::default(); MAX_SENSORS],
            health: [SensorHealth::default(); MAX_SENSORS],
        };
        let state = self.state.borrow_mut();
        let Output { contact, log_mel, health, .. } = &mut output;
        let given = inputs.iter().copied().chain(core::iter::repeat(SensorInput::default()));
        let results = contact.iter_mut().zip(log_mel).zip(health).take(self.sensors);
        for (((input, ear), ((contact, log_mel), health)), _) in
            given.zip(&mut state.ears).zip(results).zip(0..MAX_SENSORS)
        {
            if let Some(frame) = input.piezo {
                *contact = ContactSummary::new(frame);
            }
            match input.xl {
                Some(samples) => *log_mel = ear.listen(samples),
                // A gap: what is heard after it must not be joined to what was heard before.
                None => *ear = Ear::new(),
            }
            *health = sensor_health(&input, ear);
        }

        let mut seen = [SensorFeatures::default(); MAX_SENSORS];
        for ((seen, input), log_mel) in seen.iter_mut().zip(inputs).zip(&output.log_mel) {
            *seen = SensorFeatures { piezo: input.piezo, log_mel: input.xl.map(|_| &log_mel.standardised) };
        }
        output.logits =
            state.network.step(&self.model, seen.get(..self.sensors).unwrap_or_default(), &mut ());
        let touched = touched(inputs, &output.contact, self.sensors);
        output.class = Class::new(touched, output.logits);
        output.slip = output.class == Class::Slip;
        output.margin = margin(touched, output.logits);
        output.alarm = self.decision.step(output.margin);
        output
    }
}

/// What is wrong with a sensor.
fn sensor_health(input: &SensorInput<'_>, ear: &Ear) -> SensorHealth {
    let mut bits = 0;
    match input.piezo {
        None => bits |= health::PIEZO_MISSING,
        Some(frame) => {
            if frame.is_saturated() {
                bits |= health::TAXELS_SATURATED;
            }
            if frame.is_masked() {
                bits |= health::TAXELS_MASKED;
            }
        }
    }
    match input.xl {
        None => bits |= health::XL_MISSING,
        Some(samples) => {
            if ear.heard < XL_WINDOW {
                bits |= health::XL_WARMING_UP;
            }
            if samples.as_flattened().iter().any(|&x| x == i16::MAX || x == i16::MIN) {
                bits |= health::XL_CLIPPED;
            }
            if samples.len() > RAW_XL_MAX {
                bits |= health::XL_SAMPLES_DROPPED;
            }
        }
    }
    SensorHealth(bits)
}

/// Is anything held? `None` if a missing array leaves it open. Per-unit rule: no contact only if
/// every pad is below the threshold.
fn touched(inputs: &[SensorInput<'_>], contact: &[ContactSummary], sensors: usize) -> Option<bool> {
    if contact.iter().any(|pad| pad.sum >= CONTACT_SUM_MIN) {
        return Some(true);
    }
    let delivered = inputs.iter().take(sensors).filter(|input| input.piezo.is_some()).count();
    (delivered == sensors).then_some(false)
}
