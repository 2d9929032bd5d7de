//! Every setting, once: what it is called, what it may be, what it is until somebody says otherwise.

use super::value::{ELEMENTS_MAX, Kind};
use crate::net::format::{DECISION_FRAMES_MAX, OperatingPoint};
use crate::params::{FRAME_RATE_HZ, MAX_SENSORS, TAXEL_ROWS};
use crate::wire::NodeId;

/// The names of the settings. The number of each is its name in flash: a new one gets a new number, that of
/// one that is gone is never used again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[expect(missing_docs, reason = "the table says what each is")]
pub enum Setting {
    /// Address on the bus, or [`NODE_ID_UNSET`].
    NodeId = 0,
    BitRates = 1,
    Sensors = 2,
    RawDivider = 3,
    PointOverride = 4,
    OperatingPoint = 5,
    SensorOrder = 6,
    Orientation = 7,
    TaxelMask0 = 8,
    TaxelMask1 = 9,
    TaxelMask2 = 10,
    TimeSync = 11,
    PlugAndPlay = 12,
    CompressRaw = 13,
    Lock = 14,
    ExpectedModel = 15,
}

/// The value of [`Setting::NodeId`] that means: none.
pub const NODE_ID_UNSET: i64 = 65_535;

/// Bit rate of the arbitration phase, bit/s: the one that bit timings exist for.
pub const NOMINAL_BIT_RATES: &[i64] = &[1_000_000];
/// Bit rates of the data phase, bit/s, that bit timings exist for.
pub const DATA_BIT_RATES: &[i64] = &[5_000_000, 8_000_000];

/// What an element of a setting may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Any number of these, ends included.
    Range(i64, i64),
    /// Any number of these, ends included, or the third.
    RangeOr(i64, i64, i64),
    /// One of these.
    Choice(&'static [i64]),
}

impl Rule {
    /// Is this number one?
    pub fn allows(self, value: i64) -> bool {
        match self {
            Self::Range(min, max) => (min..=max).contains(&value),
            Self::RangeOr(min, max, other) => (min..=max).contains(&value) || value == other,
            Self::Choice(choice) => choice.contains(&value),
        }
    }

    /// The smallest and the largest.
    pub fn bounds(self) -> (i64, i64) {
        match self {
            Self::Range(min, max) => (min, max),
            Self::RangeOr(min, max, other) => (min.min(other), max.max(other)),
            Self::Choice(choice) => {
                (choice.iter().copied().min().unwrap_or(0), choice.iter().copied().max().unwrap_or(0))
            }
        }
    }
}

impl core::fmt::Display for Rule {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Range(min, max) => write!(f, "{min} to {max}"),
            Self::RangeOr(min, max, other) => write!(f, "{min} to {max} and {other}"),
            Self::Choice(choice) => {
                for (index, value) in choice.iter().enumerate() {
                    write!(f, "{}{value}", if index == 0 { "" } else { " and " })?;
                }
                Ok(())
            }
        }
    }
}

/// When a new value counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// With the next frame.
    AtOnce,
    /// When the board starts anew; store it first.
    AfterRestart,
}

/// A rule that elements keep together; the text is what the numbers must be.
pub type Together = (fn(&[i64]) -> bool, &'static str);

/// All there is to know about a setting. Every setting can be written on the bus and stored in flash.
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Definition {
    pub setting: Setting,
    pub name: &'static str,
    /// How its elements are written.
    pub kind: Kind,
    /// What each element may be; the last entry is for all that follow.
    pub rules: &'static [Rule],
    /// The elements until they are set.
    pub default: &'static [i64],
    /// What the elements must be together.
    pub together: Option<Together>,
    /// Unit of the elements, empty for a number of something.
    pub unit: &'static str,
    /// What it is for, one line.
    pub help: &'static str,
    /// When a new value counts.
    pub effect: Effect,
}

impl Definition {
    /// What element `index` may be.
    pub fn rule(&self, index: usize) -> Rule {
        self.rules.get(index).or(self.rules.last()).copied().unwrap_or(Rule::Choice(&[]))
    }
}

/// Off, and what most settings have in common.
const SWITCH: Definition = Definition {
    setting: Setting::NodeId,
    name: "",
    kind: Kind::Bit,
    rules: &[Rule::Range(0, 1)],
    default: &[0],
    together: None,
    unit: "",
    help: "",
    effect: Effect::AtOnce,
};
const SENSOR_LAST: i64 = MAX_SENSORS as i64 - 1;
const NO_TAXEL: &[i64] = &[0; TAXEL_ROWS];
const MASK: &[Rule] = &[Rule::Range(0, u32::MAX as i64)];

const fn mask(setting: Setting, name: &'static str) -> Definition {
    Definition {
        setting,
        name,
        kind: Kind::Natural32,
        rules: MASK,
        default: NO_TAXEL,
        help: "taxels that are ignored: one number a row, bit c is column c",
        ..SWITCH
    }
}

/// The settings, in the order of their numbers.
pub static TABLE: [Definition; 16] = [
    Definition {
        setting: Setting::NodeId,
        name: "uavcan.node.id",
        kind: Kind::Natural16,
        rules: &[Rule::RangeOr(0, 127, NODE_ID_UNSET)],
        default: &[NodeId::DEFAULT.get() as i64],
        help: "address on the bus; 65535: none, ask for one",
        effect: Effect::AfterRestart,
        ..SWITCH
    },
    Definition {
        setting: Setting::BitRates,
        name: "uavcan.can.bitrate",
        kind: Kind::Natural32,
        rules: &[Rule::Choice(NOMINAL_BIT_RATES), Rule::Choice(DATA_BIT_RATES)],
        default: &[1_000_000, 8_000_000],
        unit: "bit/s",
        help: "bit rates of arbitration and data phase",
        effect: Effect::AfterRestart,
        ..SWITCH
    },
    Definition {
        setting: Setting::Sensors,
        name: "slipsense.sensors",
        kind: Kind::Natural8,
        rules: &[Rule::Range(1, MAX_SENSORS as i64)],
        default: &[1],
        help: "sensors in use",
        effect: Effect::AfterRestart,
        ..SWITCH
    },
    Definition {
        setting: Setting::RawDivider,
        name: "slipsense.raw.divider",
        kind: Kind::Natural8,
        rules: &[Rule::Range(0, FRAME_RATE_HZ as i64)],
        default: &[1],
        unit: "frames",
        help: "every n-th frame is sent raw; 0: none",
        ..SWITCH
    },
    Definition {
        setting: Setting::PointOverride,
        name: "slipsense.slip.override",
        help: "the flag is decided at slipsense.slip.point, not at the model's operating point",
        ..SWITCH
    },
    Definition {
        setting: Setting::OperatingPoint,
        name: "slipsense.slip.point",
        kind: Kind::Integer32,
        rules: &[
            Rule::Range(
                OperatingPoint::THRESHOLD_MIN.to_bits() as i64,
                OperatingPoint::THRESHOLD_MAX.to_bits() as i64,
            ),
            Rule::Range(1, DECISION_FRAMES_MAX as i64),
            Rule::Range(1, DECISION_FRAMES_MAX as i64),
        ],
        default: &[0, 1, 1],
        together: Some((k_within_n, "element 1 (k) at most element 2 (n)")),
        unit: "1/1024 nat, frames, frames",
        help: "threshold, k and n: the flag is up when k of the last n frames are over the threshold",
        ..SWITCH
    },
    Definition {
        setting: Setting::SensorOrder,
        name: "slipsense.sensor.order",
        kind: Kind::Natural8,
        rules: &[Rule::Range(0, SENSOR_LAST)],
        default: &[0, 1, 2],
        together: Some((distinct, "each connector once")),
        help: "connector of sensors 0, 1 and 2",
        effect: Effect::AfterRestart,
        ..SWITCH
    },
    Definition {
        setting: Setting::Orientation,
        name: "slipsense.sensor.orientation",
        kind: Kind::Natural8,
        rules: &[Rule::Range(0, 3)],
        default: &[0, 0, 0],
        help: "mounting of sensors 0, 1 and 2: 1 rows reversed, 2 columns reversed, 3 both (turned by 180 degrees)",
        ..SWITCH
    },
    mask(Setting::TaxelMask0, "slipsense.sensor.0.mask"),
    mask(Setting::TaxelMask1, "slipsense.sensor.1.mask"),
    mask(Setting::TaxelMask2, "slipsense.sensor.2.mask"),
    Definition {
        setting: Setting::TimeSync,
        name: "slipsense.time.sync",
        default: &[1],
        help: "follow the bus time (uavcan.time.Synchronization)",
        ..SWITCH
    },
    Definition {
        setting: Setting::PlugAndPlay,
        name: "slipsense.pnp",
        default: &[1],
        help: "ask for an address when uavcan.node.id is 65535",
        ..SWITCH
    },
    Definition {
        setting: Setting::CompressRaw,
        name: "slipsense.raw.compressed",
        help: "raw frames go as slipsense.RawCompressed: without loss, and less of them where the bus is full",
        ..SWITCH
    },
    Definition {
        setting: Setting::Lock,
        name: "slipsense.lock",
        help: "settings, commands and updates are refused until the node is unlocked with an update key",
        effect: Effect::AfterRestart,
        ..SWITCH
    },
    Definition {
        setting: Setting::ExpectedModel,
        name: "slipsense.model.expected",
        kind: Kind::Natural32,
        rules: MASK,
        default: &[0, 0],
        help: "first 8 bytes of slipsense.model.hash as two big-endian numbers: with another model every slip message is invalid; 0, 0: any model",
        ..SWITCH
    },
];

fn k_within_n(point: &[i64]) -> bool {
    matches!(point, [_, k, n] if k <= n)
}

fn distinct(order: &[i64]) -> bool {
    order.iter().enumerate().all(|(index, value)| order.iter().take(index).all(|before| before != value))
}

impl Setting {
    /// Its entry in the table.
    pub fn definition(self) -> &'static Definition {
        // The table is in the order of the numbers: asserted below.
        &TABLE[self as usize]
    }

    /// The setting of this number.
    pub fn from_number(number: u8) -> Option<Self> {
        TABLE.get(usize::from(number)).map(|definition| definition.setting)
    }

    /// The setting whose register has this name.
    pub fn from_name(name: &[u8]) -> Option<Self> {
        TABLE.iter().find(|definition| definition.name.as_bytes() == name).map(|found| found.setting)
    }
}

/// Elements of all settings.
pub(super) const ELEMENTS: usize = START[TABLE.len()];
/// Where each setting's elements begin among all, and where the last ones end.
pub(super) const START: [usize; TABLE.len() + 1] = {
    let mut start = [0; TABLE.len() + 1];
    let mut index = 0;
    while index < TABLE.len() {
        let length = TABLE[index].default.len();
        assert!(length <= ELEMENTS_MAX);
        assert!(TABLE[index].setting as usize == index, "the table is in the order of the numbers");
        start[index + 1] = start[index] + length;
        index += 1;
    }
    start
};
/// Bytes of all elements in flash.
pub(super) const ELEMENT_BYTES: usize = {
    let mut bytes = 0;
    let mut index = 0;
    while index < TABLE.len() {
        bytes += TABLE[index].default.len() * TABLE[index].kind.bytes();
        index += 1;
    }
    bytes
};
