//! Sensor data of one frame in, one decision out: what firmware, simulator, replay and tests all call.
//!
//! A pure function of its inputs and its state: no clock, no I/O, no logging. It never fails; what is
//! missing or doubtful is flagged and left out, the rest goes on.

use core::borrow::BorrowMut;

use crate::contact::ContactSummary;
use crate::decision::Decision;
use crate::features::piezo::PiezoFrontEnd;
use crate::features::{LogMel, XlFrontEnd};
use crate::fixed::{Logit, Q};
use crate::health::{self, SensorHealth, bits_if};
use crate::net::format::OperatingPoint;
use crate::net::{Model, NetworkState, SensorFeatures};
use crate::params::{CLASSES, CONTACT_SUM_MIN, FRAME_RATE_HZ, MAX_SENSORS, XL_WINDOW, limits::WINDOW};
use crate::sensor::{SensorInput, SensorReadings, TaxelMask, XlSample};
use crate::wire::{
    CRC_32, DEGRADED_FROZEN, DEGRADED_MISSING, DEGRADED_POINT, INVALID_NO_SENSOR, INVALID_STARTING, Origin,
    RAW_XL_MAX, RawFrame, SensorContact, SlipMessage, fold, wire_logit,
};

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
    /// Slip may begin: `class` is [`Class::Slip`].
    pub may_begin: bool,
    /// The detector's log-odds of slip; `None` where no pad is touched: that cannot slip.
    pub log_odds: Option<Logit>,
    /// The flag to act on: slip by the operating point.
    pub slip: bool,
    /// Why `slip` must not be believed: bits such as [`INVALID_STARTING`].
    pub invalid: u8,
    /// What makes `slip` worse: bits such as [`DEGRADED_MISSING`].
    pub degraded: u8,
    /// Hash of model, operating point, masks and mountings.
    pub configuration: u16,
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
    /// The message that carries this result.
    pub fn slip_message(&self, stamp: FrameStamp, origin: &Origin) -> SlipMessage {
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
        let message = origin.message(self.sensors, self.configuration);
        SlipMessage {
            timestamp_us: stamp.timestamp_us,
            sequence: stamp.sequence,
            class: self.class as u8,
            slip: self.slip,
            may_begin: self.may_begin,
            invalid: message.invalid | self.invalid,
            degraded: message.degraded | self.degraded,
            logits: self.logits.map(wire_logit),
            log_odds: self.log_odds.map_or(Q::from_bits(i16::MIN), wire_logit),
            contact,
            ..message
        }
    }

    /// The raw frame of one sensor: what the pipeline was given, and what it thought of it.
    pub fn raw_frame<'a>(&self, stamp: FrameStamp, sensor: usize, input: SensorInput<'a>) -> RawFrame<'a> {
        RawFrame {
            timestamp_us: stamp.timestamp_us,
            sequence: stamp.sequence,
            sensor: sensor as u8,
            health: self.health.get(sensor).copied().unwrap_or_default().0,
            input,
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

/// One accelerometer's front end, and which samples it has seen.
#[derive(Clone, Debug)]
struct XlChannel {
    front_end: XlFrontEnd,
    /// Samples since the start or the last gap, up to a full window.
    samples_seen: usize,
    /// Index of the sample that comes next; `None` before the first batch and after a frame without one.
    next: Option<u32>,
}

impl XlChannel {
    const fn new() -> Self {
        Self { front_end: XlFrontEnd::new(), samples_seen: 0, next: None }
    }

    /// Samples are missing.
    fn restart(&mut self) {
        self.front_end.restart();
        (self.samples_seen, self.next) = (0, None);
    }

    /// Take in the samples of a frame, up to the index `end`. `true`: samples are missing before them. Then, as after a
    /// frame without samples, the front end [restarts](XlFrontEnd::restart).
    fn push(&mut self, samples: &[XlSample], end: u32) -> bool {
        let first = end.wrapping_sub(samples.len() as u32);
        let gap = self.next.is_some_and(|next| next != first);
        if gap {
            self.restart();
        }
        self.front_end.push(samples);
        self.samples_seen = self.samples_seen.saturating_add(samples.len()).min(XL_WINDOW);
        self.next = Some(end);
        gap
    }
}

/// All that is remembered between raw samples and decision, whatever the model and the sensors. All of it starts as
/// zeros, so that a microcontroller makes it where it is to stay.
#[derive(Clone, Debug)]
pub struct State {
    xl: [XlChannel; MAX_SENSORS],
    piezo: [PiezoFrontEnd; MAX_SENSORS],
    network: NetworkState,
}

impl State {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self {
            xl: [const { XlChannel::new() }; MAX_SENSORS],
            piezo: [const { PiezoFrontEnd::new() }; MAX_SENSORS],
            network: NetworkState::new(),
        }
    }
}

/// Of each sensor: are its rows reversed, are its columns?
pub type Mountings = [(bool, bool); MAX_SENSORS];

/// The signal path of one module. It owns its state, or works on one that lies elsewhere.
#[derive(Clone, Debug)]
pub struct Pipeline<'m, S = State> {
    sensors: usize,
    model: Model<'m>,
    state: S,
    decision: Decision,
    /// Taxels to mask in [`step_readings`](Self::step_readings), by sensor.
    masks: [TaxelMask; MAX_SENSORS],
    mountings: Mountings,
    /// Of model, operating point, masks and mountings.
    configuration: u16,
    /// Frames so far, up to as many as the network looks back.
    frames: usize,
}

/// The RAM that a pipeline takes, whatever the model.
pub const PIPELINE_BYTES_MAX: usize = 100_000;
const _: () = assert!(size_of::<Pipeline<'static>>() <= PIPELINE_BYTES_MAX);

impl<'m> Pipeline<'m> {
    /// Before the first frame, for 1 to [`MAX_SENSORS`] sensors.
    pub fn new(model: Model<'m>, sensors: usize) -> Result<Self, SensorCountError> {
        Self::with_state(State::new(), model, sensors)
    }
}

impl<'m, S: BorrowMut<State>> Pipeline<'m, S> {
    /// As [`Pipeline::new`], on a state as it is at first.
    pub fn with_state(state: S, model: Model<'m>, sensors: usize) -> Result<Self, SensorCountError> {
        if sensors == 0 || sensors > MAX_SENSORS {
            return Err(SensorCountError { sensors });
        }
        let decision = Decision::new(model.point);
        let masks = [TaxelMask::NONE; MAX_SENSORS];
        let mountings = Mountings::default();
        let configuration = hash(&model, model.point, &masks, mountings);
        Ok(Self { sensors, model, state, decision, masks, mountings, configuration, frames: 0 })
    }

    /// Sensors in use.
    pub const fn sensors(&self) -> usize {
        self.sensors
    }

    /// All that is remembered from frame to frame but the decision's history.
    pub fn state_mut(&mut self) -> &mut State {
        self.state.borrow_mut()
    }

    /// The model in use.
    pub const fn model(&self) -> &Model<'m> {
        &self.model
    }

    /// Decide at this operating point, one that [`OperatingPoint::check`] accepts; `None`: at the model's. Mask these
    /// taxels in [`step_readings`](Self::step_readings). A new point begins with nothing remembered. `mountings`: how
    /// the drivers turn the arrays, for [`Output::configuration`] only.
    pub fn configure(
        &mut self,
        point: Option<OperatingPoint>,
        masks: &[TaxelMask; MAX_SENSORS],
        mountings: Mountings,
    ) {
        let point = point.unwrap_or(self.model.point);
        let (new_point, new_masks) = (self.decision.point() != point, self.masks != *masks);
        if new_point {
            self.decision = Decision::new(point);
        }
        if new_masks {
            self.masks = *masks;
        }
        if new_point || new_masks || self.mountings != mountings {
            self.mountings = mountings;
            self.configuration = hash(&self.model, self.decision.point(), &self.masks, mountings);
        }
    }

    /// Take in one frame as the drivers deliver it. Masked taxels ([`configure`](Self::configure)) and those found stuck are
    /// set to 0 first, in place, so that raw messages carry what the network sees. A recording's scans are masked already.
    pub fn step_readings(&mut self, readings: &mut [SensorReadings; MAX_SENSORS]) -> Output {
        for (readings, mask) in
            readings.iter_mut().zip(&self.masks).filter(|(readings, _)| readings.piezo_arrived)
        {
            readings.piezo.mask(&readings.stuck.union(mask));
        }
        self.step(&readings.each_ref().map(SensorReadings::input))
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
            may_begin: false,
            log_odds: None,
            slip: false,
            invalid: 0,
            degraded: 0,
            configuration: self.configuration,
            sensors: self.sensors,
            contact: [ContactSummary::default(); MAX_SENSORS],
            log_mel: [LogMel::default(); MAX_SENSORS],
            health: [SensorHealth::default(); MAX_SENSORS],
        };
        let state = self.state.borrow_mut();
        let Output { contact, log_mel, health, .. } = &mut output;
        let given = inputs.iter().copied().chain(core::iter::repeat(SensorInput::default()));
        let results = contact.iter_mut().zip(log_mel).zip(health).take(self.sensors);
        for ((input, xl), ((contact, log_mel), health)) in given.zip(&mut state.xl).zip(results) {
            if let Some(frame) = input.piezo {
                *contact = ContactSummary::new(frame);
            }
            let mut gap = false;
            match input.xl {
                Some(samples) => {
                    gap = xl.push(samples, input.xl_end);
                    *log_mel = xl.front_end.log_mel();
                }
                None => xl.restart(),
            }
            *health = sensor_health(&input, xl.samples_seen, gap);
        }

        let mut seen = [SensorFeatures::default(); MAX_SENSORS];
        for ((seen, input), log_mel) in seen.iter_mut().zip(inputs).zip(&output.log_mel) {
            *seen = SensorFeatures { piezo: input.piezo, xl: input.xl.map(|_| log_mel.features()) };
        }
        let [no_contact, no_slip, slip, log_odds] = state.network.step(
            &self.model,
            &mut state.piezo,
            seen.get(..self.sensors).unwrap_or_default(),
            &mut (),
        );
        output.logits = [no_contact, no_slip, slip];
        let touched = touched(inputs, &output.contact, self.sensors);
        output.class = Class::new(touched, output.logits);
        output.may_begin = output.class == Class::Slip;
        output.log_odds = (touched != Some(false)).then_some(log_odds);
        output.slip = self.decision.step(output.log_odds);
        self.frames = (self.frames + 1).min(WINDOW);
        self.doubt(&mut output);
        output
    }

    /// What speaks against the flag.
    fn doubt(&self, output: &mut Output) {
        let mut delivers = false;
        for (health, log_mel) in output.health.iter().zip(&output.log_mel).take(self.sensors) {
            let frozen = is_frozen(log_mel, *health);
            delivers |=
                !(health.contains(health::PIEZO_MISSING) && (frozen || health.contains(health::XL_MISSING)));
            let missing = health.intersects(health::PIEZO_MISSING | health::XL_MISSING);
            output.degraded |= bits_if(frozen, DEGRADED_FROZEN) | bits_if(missing, DEGRADED_MISSING);
        }
        output.degraded |= bits_if(self.decision.point() != self.model.point, DEGRADED_POINT);
        output.invalid |=
            bits_if(self.frames < WINDOW, INVALID_STARTING) | bits_if(!delivers, INVALID_NO_SENSOR);
    }
}

/// Hash of what decides beside the signals.
#[inline(never)]
fn hash(
    model: &Model<'_>,
    point: OperatingPoint,
    masks: &[TaxelMask; MAX_SENSORS],
    mountings: Mountings,
) -> u16 {
    let OperatingPoint { threshold, k, n } = point;
    let mut digest = CRC_32.digest();
    digest.update(&model.hash);
    digest.update(&threshold.to_bits().to_le_bytes());
    digest.update(&[k, n]);
    masks.iter().flat_map(|mask| &mask.0).for_each(|row| digest.update(&row.to_le_bytes()));
    digest.update(&mountings.map(|(rows, cols)| u8::from(rows) | u8::from(cols) << 1));
    fold(digest.finalize())
}

/// Do the samples not change? Rounding alone puts more than the logarithm's floor into every bin of a live part.
fn is_frozen(log_mel: &LogMel, health: SensorHealth) -> bool {
    !health.intersects(health::XL_MISSING | health::XL_WARMING_UP)
        && log_mel.ln_power.iter().all(|&ln| ln == 0)
}

/// What is wrong with a sensor; `gap`: samples are missing before those of this frame.
fn sensor_health(input: &SensorInput<'_>, samples_seen: usize, gap: bool) -> SensorHealth {
    let piezo = match input.piezo {
        None => health::PIEZO_MISSING,
        Some(frame) => {
            bits_if(frame.is_saturated(), health::TAXELS_SATURATED)
                | bits_if(frame.is_masked(), health::TAXELS_MASKED)
        }
    };
    let xl = match input.xl {
        None => health::XL_MISSING,
        Some(samples) => {
            let clipped = samples.as_flattened().iter().any(|&x| x == i16::MAX || x == i16::MIN);
            bits_if(samples_seen < XL_WINDOW, health::XL_WARMING_UP)
                | bits_if(clipped, health::XL_CLIPPED)
                | bits_if(gap || samples.len() > RAW_XL_MAX, health::XL_SAMPLES_DROPPED)
        }
    };
    SensorHealth(piezo | xl)
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
