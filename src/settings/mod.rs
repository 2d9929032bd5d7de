//! What can be set, and how it survives a power cut. [`TABLE`] defines every setting once, [`Settings`] holds a valid
//! value of each, and [`SettingsStore`] keeps one whole configuration in flash: after a power cut at any moment either
//! the old or the new one is found, never a mixture.

mod encoding;
mod store;
mod table;
mod value;

use core::fmt;

pub use encoding::{Damage, ENCODED_MAX};
pub use store::{LoadReport, Origin, RangeError, SCRATCH, Scratch, SettingsStore, StoreError};
pub use table::{
    DATA_BIT_RATES, Definition, Effect, NODE_ID_UNSET, NOMINAL_BIT_RATES, Rule, Setting, TABLE, Together,
};
pub use value::{ELEMENTS_MAX, Kind};

use crate::fixed::Logit;
use crate::net::format::{HASH_BYTES, OperatingPoint};
use crate::params::MAX_SENSORS;
use crate::sensor::TaxelMask;
use crate::wire::NodeId;

/// A valid value of every setting.
#[derive(Clone, PartialEq, Eq)]
pub struct Settings {
    elements: [i64; table::ELEMENTS],
}

/// Why a value was not taken: the setting's register, what was found, what is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum SettingError {
    Elements {
        name: &'static str,
        expected: usize,
        found: usize,
    },
    /// An element, counted from 0, is out of its range.
    Element {
        name: &'static str,
        index: usize,
        value: i64,
        rule: Rule,
    },
    Together {
        name: &'static str,
        rule: &'static str,
    },
}

impl fmt::Display for SettingError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Elements { name, expected, found } => {
                write!(f, "{name}: {found} elements, need {expected}")
            }
            Self::Element { name, index, value, rule } => {
                write!(f, "{name}: element {index} is {value}, allowed are {rule}")
            }
            Self::Together { name, rule } => write!(f, "{name}: need {rule}"),
        }
    }
}

impl core::error::Error for SettingError {}

/// The numbers of [`Setting::ExpectedModel`] for a model of this hash: its first eight bytes, big-endian.
pub fn model_numbers(hash: &[u8; HASH_BYTES]) -> [u32; 2] {
    let &[a, b, c, d, e, f, g, h, ..] = hash;
    [u32::from_be_bytes([a, b, c, d]), u32::from_be_bytes([e, f, g, h])]
}

impl Settings {
    /// The defaults.
    pub fn new() -> Self {
        let mut settings = Self { elements: [0; table::ELEMENTS] };
        for definition in &TABLE {
            settings.put(definition.setting, definition.default);
        }
        settings
    }

    /// The elements of a setting.
    pub fn get(&self, setting: Setting) -> &[i64] {
        self.elements.get(span(setting)).unwrap_or(&[])
    }

    /// Take a new value, if it is valid. Says whether it differs from the old one.
    pub fn set(&mut self, setting: Setting, elements: &[i64]) -> Result<bool, SettingError> {
        check(setting, elements)?;
        let changed = self.get(setting) != elements;
        self.put(setting, elements);
        Ok(changed)
    }

    fn put(&mut self, setting: Setting, elements: &[i64]) {
        let own = self.elements.get_mut(span(setting)).unwrap_or(&mut []);
        for (own, &element) in own.iter_mut().zip(elements) {
            *own = element;
        }
    }

    fn first(&self, setting: Setting) -> i64 {
        self.get(setting).first().copied().unwrap_or(0)
    }

    /// Is this setting, of [`Kind::Bit`], on?
    pub fn is_on(&self, setting: Setting) -> bool {
        self.first(setting) != 0
    }

    /// Address on the bus; `None`: ask for one.
    pub fn node_id(&self) -> Option<NodeId> {
        u8::try_from(self.first(Setting::NodeId)).ok().and_then(NodeId::new)
    }

    /// Bit rates of arbitration and data phase, bit/s.
    pub fn bit_rates(&self) -> (u32, u32) {
        match *self.get(Setting::BitRates) {
            [nominal, data] => (nominal as u32, data as u32),
            _ => (0, 0),
        }
    }

    /// Sensors in use, 1 to [`MAX_SENSORS`].
    pub fn sensors(&self) -> usize {
        self.first(Setting::Sensors) as usize
    }

    /// Every n-th frame is sent raw; 0: none.
    pub fn raw_divider(&self) -> u32 {
        self.first(Setting::RawDivider) as u32
    }

    /// The flag's operating point, where it is not the model's.
    pub fn operating_point(&self) -> Option<OperatingPoint> {
        if !self.is_on(Setting::PointOverride) {
            return None;
        }
        match *self.get(Setting::OperatingPoint) {
            [threshold, k, n] => {
                Some(OperatingPoint { threshold: Logit::from_bits(threshold as i32), k: k as u8, n: n as u8 })
            }
            _ => None,
        }
    }

    /// Connector of each sensor.
    pub fn sensor_order(&self) -> [usize; MAX_SENSORS] {
        self.per_sensor(Setting::SensorOrder).map(|connector| connector as usize)
    }

    /// Of each sensor: are its rows reversed, are its columns?
    pub fn orientation(&self) -> [(bool, bool); MAX_SENSORS] {
        self.per_sensor(Setting::Orientation).map(|bits| (bits & 1 != 0, bits & 2 != 0))
    }

    fn per_sensor(&self, setting: Setting) -> [i64; MAX_SENSORS] {
        self.get(setting).first_chunk().copied().unwrap_or_default()
    }

    /// Taxels of a sensor that are ignored; none of a sensor that does not exist.
    pub fn taxel_mask(&self, sensor: usize) -> TaxelMask {
        let settings = [Setting::TaxelMask0, Setting::TaxelMask1, Setting::TaxelMask2];
        let rows = settings.get(sensor).map_or(&[][..], |&setting| self.get(setting));
        let mut mask = TaxelMask::NONE;
        for (row, &element) in mask.0.iter_mut().zip(rows) {
            *row = element as u32;
        }
        mask
    }

    /// As [`model_numbers`] gives them: the model that must run; `None`: any may.
    pub fn expected_model(&self) -> Option<[u32; 2]> {
        match *self.get(Setting::ExpectedModel) {
            [first, second] if [first, second] != [0, 0] => Some([first as u32, second as u32]),
            _ => None,
        }
    }
}

impl fmt::Debug for Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_map().entries(TABLE.iter().map(|entry| (entry.name, self.get(entry.setting)))).finish()
    }
}

/// Is this a valid value?
pub fn check(setting: Setting, elements: &[i64]) -> Result<(), SettingError> {
    let definition = setting.definition();
    let (name, expected, found) = (definition.name, definition.default.len(), elements.len());
    if expected != found {
        return Err(SettingError::Elements { name, expected, found });
    }
    for (index, &value) in elements.iter().enumerate() {
        let rule = definition.rule(index);
        if !rule.allows(value) {
            return Err(SettingError::Element { name, index, value, rule });
        }
    }
    match definition.together {
        Some((holds, rule)) if !holds(elements) => Err(SettingError::Together { name, rule }),
        _ => Ok(()),
    }
}

/// Where a setting's elements are among all.
fn span(setting: Setting) -> core::ops::Range<usize> {
    let number = setting as usize;
    match table::START {
        starts if number + 1 < starts.len() => starts[number]..starts[number + 1],
        _ => 0..0,
    }
}
