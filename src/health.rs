//! How the sensors, the bus and the whole node are: health bits, counters, and what follows from them.

use crate::calibration::{Progress, State, Summary};
use crate::params::MAX_SENSORS;
use crate::sensor::TaxelMask;

/// No array scan for this frame; its taxels are sent as zeros.
pub const PIEZO_MISSING: u8 = 1;
/// The accelerometer delivered nothing for this frame.
pub const XL_MISSING: u8 = 2;
/// Fewer samples than one analysis window so far.
pub const XL_WARMING_UP: u8 = 4;
/// An accelerometer sample at full scale.
pub const XL_CLIPPED: u8 = 8;
/// A taxel at full scale.
pub const TAXELS_SATURATED: u8 = 16;
/// Accelerometer samples were lost before the front end, or more came than a raw message holds.
pub const XL_SAMPLES_DROPPED: u8 = 32;
/// The node has no readable model: class, flag and logits of the message mean nothing.
pub const NO_MODEL: u8 = 64;
/// Taxels are masked, by a setting, by the calibration or as found stuck: they read 0 here and for the network.
pub const TAXELS_MASKED: u8 = 128;

/// These bits where it is so, else none.
#[inline]
pub(crate) const fn bits_if(is_so: bool, bits: u8) -> u8 {
    if is_so { bits } else { 0 }
}

/// Health byte of one sensor at one frame: any of the bits above; 0 is a healthy sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SensorHealth(pub u8);

impl SensorHealth {
    /// Are all of these bits set?
    pub const fn contains(self, bits: u8) -> bool {
        self.0 & bits == bits
    }

    /// Is one of these bits set?
    pub const fn intersects(self, bits: u8) -> bool {
        self.0 & bits != 0
    }
}

/// How a node is: the values of `uavcan.node.Health.1.0`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Condition {
    /// Everything works.
    #[default]
    Nominal = 0,
    /// Something was lost or is doubtful; the slip message is what it should be.
    Advisory = 1,
    /// A part is missing: decisions are made on what is left.
    Caution = 2,
    /// There are no decisions, or nobody gets them.
    Warning = 3,
}

/// Fault confinement state of a CAN node (ISO 11898-1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum CanState {
    /// No error counter has reached 96.
    #[default]
    ErrorActive = 0,
    /// An error counter has reached 96.
    Warning = 1,
    /// An error counter has passed 127: often nobody acknowledges.
    ErrorPassive = 2,
    /// The transmit error counter has passed 255: the node takes no part until it has seen 128 times 11 recessive
    /// bits.
    BusOff = 3,
}

/// State and error counters of a CAN node.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct CanStatus {
    pub state: CanState,
    pub transmit_errors: u8,
    pub receive_errors: u8,
}

/// What reset the chip, by its reset flags (RM0433, RCC_RSR).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum ResetCause {
    /// None of the flags.
    #[default]
    Unknown = 0,
    /// The supply came.
    PowerOn = 1,
    /// The supply fell below the brown-out level.
    BrownOut = 2,
    /// The reset pin alone: a button or a probe.
    Pin = 3,
    /// The program, after a command or a crash.
    Software = 4,
    /// The watchdog.
    Watchdog = 5,
}

impl ResetCause {
    /// Of the flags in RCC_RSR. Every reset but those of other domains sets the pin's too, and that of the supply all.
    pub fn from_flags(rsr: u32) -> Self {
        let by_weight = [
            (1 << 23, Self::PowerOn),
            (1 << 21, Self::BrownOut),
            (1 << 26, Self::Watchdog),
            (1 << 24, Self::Software),
            (1 << 22, Self::Pin),
        ];
        by_weight.into_iter().find(|(flag, _)| rsr & flag != 0).map_or(Self::Unknown, |(_, cause)| cause)
    }
}

/// Numbers of [`Status::restart`].
pub const RESTART_NUMBERS: usize = 6;

/// What the node checks of itself, each a bit of [`SelfChecks::failed`] in this order.
pub const SELF_CHECKS: [&str; 4] =
    ["the model in RAM", "the inner loops in ITCM", "the firmware in flash", "the golden inference"];
/// The bits of code and model; the one behind them is the golden inference's.
pub const MEMORY_CHECKS: u8 = 7;

/// What the node has found out about itself since start: [`crate::tasks::SelfCheck`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SelfChecks {
    /// Times that the firmware in flash was hashed, wraps.
    pub passes: u32,
    /// Golden inferences, wraps.
    pub inferences: u32,
    /// What has failed since start: bits of [`SELF_CHECKS`].
    pub failed: u8,
}

/// What the node knows about itself, for heartbeat, registers and log. Counters count since start and stay at their
/// largest value, but for those of frames, which wrap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Status {
    /// Frames handed to inference, wraps.
    pub acquired_frames: u32,
    /// Frames for which there was no buffer.
    pub dropped_frames: u32,
    /// Frames decided, wraps.
    pub decided_frames: u32,
    /// Frames whose decision came more than a frame period after their tick.
    pub late_frames: u32,
    /// Longest time from a tick to the moment at which its slip message could go, µs.
    pub worst_frame_us: u32,
    /// Sensors in use; entries beyond are not looked at.
    pub sensors: usize,
    /// Health of each sensor at the last frame.
    pub sensor_health: [SensorHealth; MAX_SENSORS],
    /// The samples of an accelerometer in use do not change.
    pub frozen: bool,
    /// Taxels faulty by calibration or found stuck, by sensor.
    pub stuck_taxels: [TaxelMask; MAX_SENSORS],
    /// How each array is calibrated.
    pub calibrations: [Summary; MAX_SENSORS],
    /// How far the last measurement of an array is.
    pub measurement: Progress,
    /// Slip messages given up for a newer one. Not one that was withdrawn too late: it was on the wire and has gone.
    pub replaced_slips: u32,
    /// Raw messages given up before their first CAN frame.
    pub dropped_raw: u32,
    /// Raw messages cut off by bus-off.
    pub broken_raw: u32,
    /// Service frames for which there was no room.
    pub refused_services: u32,
    /// Service frames that the hardware held when the node dropped off the bus.
    pub lost_services: u32,
    /// The node on its bus.
    pub can: CanStatus,
    /// Times that the node has dropped off the bus.
    pub bus_offs: u32,
    /// Length of the last bus-off, from when it was noticed to the first slip message handed over after it, µs; 0
    /// before the first.
    pub bus_off_us: u32,
    /// Frames from the bus that were lost: the controller's FIFO or the queue behind it was full.
    pub lost_received: u32,
    /// Errors that the flash's error correction has found: of one bit, mended; of two, lost.
    pub flash_errors: [u32; 2],
    /// The same of the RAMs'.
    pub ram_errors: [u32; 2],
    /// Brown-out level of the option bytes, and whether they protect the bootloader's sector from writes (1: yes).
    pub option_bytes: [u8; 2],
    /// Hash of the reason if a panic, a fault or the watchdog caused the last start; else 0.
    pub last_panic: u32,
    /// How the node came to start: cause of the reset, see [`ResetCause`]; where it followed a crash, kind (1
    /// panic, 2 fault, 3 watchdog, 4 no clock), and of a fault PC, LR, CFSR and address, of a watchdog PC, LR and bits of
    /// the stalled tasks, of a missing clock the frequency found, Hz.
    pub restart: [u32; RESTART_NUMBERS],
    /// Starts since the supply came, this one not counted; wraps.
    pub starts: u8,
    /// Self tests since start.
    pub self_tests: u32,
    /// Self tests since start that failed.
    pub failed_self_tests: u32,
    /// What the node checks by itself.
    pub self_checks: SelfChecks,
}

impl Status {
    /// Before the first frame.
    pub const fn new() -> Self {
        Self {
            acquired_frames: 0,
            dropped_frames: 0,
            decided_frames: 0,
            late_frames: 0,
            worst_frame_us: 0,
            sensors: 1,
            sensor_health: [SensorHealth(0); MAX_SENSORS],
            frozen: false,
            stuck_taxels: [TaxelMask::NONE; MAX_SENSORS],
            calibrations: [Summary { version: 0, id: 0, faulty: 0, noise: 0 }; MAX_SENSORS],
            measurement: Progress { sensor: 0, state: State::None, frames: 0, wanted: 0, at: (0, 0) },
            replaced_slips: 0,
            dropped_raw: 0,
            broken_raw: 0,
            refused_services: 0,
            lost_services: 0,
            can: CanStatus { state: CanState::ErrorActive, transmit_errors: 0, receive_errors: 0 },
            bus_offs: 0,
            bus_off_us: 0,
            lost_received: 0,
            flash_errors: [0; 2],
            ram_errors: [0; 2],
            option_bytes: [0; 2],
            last_panic: 0,
            restart: [0; RESTART_NUMBERS],
            starts: 0,
            self_tests: 0,
            failed_self_tests: 0,
            self_checks: SelfChecks { passes: 0, inferences: 0, failed: 0 },
        }
    }

    /// Is one of these bits set for a sensor in use?
    pub fn any_sensor(&self, bits: u8) -> bool {
        self.sensor_health.iter().take(self.sensors).any(|health| health.intersects(bits))
    }

    /// Does no sensor in use deliver anything?
    pub fn no_sensor_left(&self) -> bool {
        let dead = PIEZO_MISSING | XL_MISSING;
        self.sensor_health.iter().take(self.sensors).all(|health| health.contains(dead))
    }

    /// How the node is now. What happened once and is over is in the counters.
    pub fn condition(&self) -> Condition {
        let can = self.can.state;
        if self.any_sensor(NO_MODEL) || self.self_checks.failed != 0 || can == CanState::BusOff {
            Condition::Warning
        } else if self.any_sensor(PIEZO_MISSING | XL_MISSING) || self.frozen || can == CanState::ErrorPassive
        {
            Condition::Caution
        } else if self.any_sensor(u8::MAX) || can == CanState::Warning {
            Condition::Advisory
        } else {
            Condition::Nominal
        }
    }
}

impl Default for Status {
    fn default() -> Self {
        Self::new()
    }
}
