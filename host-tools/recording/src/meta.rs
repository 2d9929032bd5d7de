//! The `meta` array: units and rates that the numbers need, and where the episode comes from.

use crate::Problem;
use serde_json::{Map, Value};
use slipsense::params::{FRAME_RATE_HZ, XL_RATE_HZ};

/// How far an accelerometer's rate may be from the nominal one, as a share of it: the part runs on its
/// own oscillator, which data sheets of this class specify to ±1–3 %.
pub const XL_RATE_TOLERANCE: f64 = 0.03;

const KEYS: [&str; 3] = ["xl_lsb_g", "xl_rate_hz", "frame_rate_hz"];

/// Units, rates and origin of an episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Meta {
    /// Acceleration of one LSB of `xl`, g; positive.
    pub xl_lsb_g: f64,
    /// Rate of the accelerometer, Hz; within [`XL_RATE_TOLERANCE`] of 8000.
    pub xl_rate_hz: f64,
    /// Frames per second, Hz; always 240.
    pub frame_rate_hz: f64,
    /// All other keys, kept as they are: platform, object, speed_mm_s, units, scenario, seed, source,
    /// licence and whatever else the writer knew.
    pub other: Map<String, Value>,
}

impl Meta {
    pub fn nominal(xl_lsb_g: f64) -> Self {
        Self {
            xl_lsb_g,
            xl_rate_hz: XL_RATE_HZ.into(),
            frame_rate_hz: FRAME_RATE_HZ.into(),
            other: Map::new(),
        }
    }

    /// Does the writer say that the data were generated?
    pub fn is_synthetic(&self) -> bool {
        let says = |key| self.other.get(key).and_then(Value::as_str).map(str::to_lowercase);
        ["source", "platform"].into_iter().filter_map(says).any(|text| text.contains("synthetic"))
    }

    /// Read UTF-8 JSON: one object, as in the `meta` array.
    pub fn from_json(json: &[u8]) -> Result<Self, Problem> {
        let text = std::str::from_utf8(json).map_err(|e| {
            Problem::array("meta", format!("must be UTF-8 JSON; byte {} is not UTF-8", e.valid_up_to()))
        })?;
        let value: Value = serde_json::from_str(text)
            .map_err(|e| Problem::array("meta", format!("must be UTF-8 JSON: {e}")))?;
        let Value::Object(mut other) = value else {
            return Err(Problem::array("meta", "must be a JSON object, {\"xl_lsb_g\": …}"));
        };
        let mut number = |key: &str| match other.remove(key) {
            None => Err(problem(key, "is missing")),
            Some(value) => value.as_f64().ok_or_else(|| problem(key, "must be a number")),
        };
        let [xl_lsb_g, xl_rate_hz, frame_rate_hz] = KEYS.map(&mut number);
        let meta =
            Self { xl_lsb_g: xl_lsb_g?, xl_rate_hz: xl_rate_hz?, frame_rate_hz: frame_rate_hz?, other };
        meta.validate()?;
        Ok(meta)
    }

    /// The JSON object, UTF-8: the three known keys and the others.
    pub fn to_json(&self) -> String {
        let mut object = self.other.clone();
        for (key, value) in KEYS.into_iter().zip([self.xl_lsb_g, self.xl_rate_hz, self.frame_rate_hz]) {
            object.insert(key.to_owned(), value.into());
        }
        Value::Object(object).to_string()
    }

    pub fn validate(&self) -> Result<(), Problem> {
        for (key, value) in KEYS.into_iter().zip([self.xl_lsb_g, self.xl_rate_hz, self.frame_rate_hz]) {
            if !(value.is_finite() && value > 0.0) {
                return Err(problem(key, &format!("is {value}: must be positive and finite")));
            }
            if self.other.contains_key(key) {
                return Err(problem(key, "must not stand among the other keys"));
            }
        }
        let nominal = f64::from(XL_RATE_HZ);
        if (self.xl_rate_hz - nominal).abs() > nominal * XL_RATE_TOLERANCE {
            let percent = 100.0 * XL_RATE_TOLERANCE;
            let rule = format!("is {}: must be within {percent} % of {nominal}", self.xl_rate_hz);
            return Err(problem("xl_rate_hz", &rule));
        }
        if self.frame_rate_hz != f64::from(FRAME_RATE_HZ) {
            let rule = format!("is {}: must be {FRAME_RATE_HZ}", self.frame_rate_hz);
            return Err(problem("frame_rate_hz", &rule));
        }
        Ok(())
    }
}

fn problem(key: &str, rule: &str) -> Problem {
    Problem::Rule(format!("`meta` key `{key}` {rule}"))
}
