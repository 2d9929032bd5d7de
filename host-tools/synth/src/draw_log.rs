//! The log of draws in an episode's metadata: every part adds what it drew under a name of its own.

use serde::Serialize;
use serde_json::{Map, Value};

#[derive(Default)]
pub(crate) struct DrawLog(Map<String, Value>);

impl DrawLog {
    pub(crate) fn add(&mut self, name: impl Into<String>, drawn: &impl Serialize) {
        let value = serde_json::to_value(drawn).expect("draws are numbers, names and lists of them");
        self.0.insert(name.into(), rounded(value));
    }

    pub(crate) fn into_value(self) -> Value {
        Value::Object(self.0)
    }
}

/// Numbers to six digits: enough to read, and short decimals survive JSON to the bit.
fn rounded(value: Value) -> Value {
    match value {
        Value::Number(n) if n.is_f64() => {
            let short = n.as_f64().map(|x| format!("{x:.5e}"));
            short.and_then(|s| s.parse::<f64>().ok()).map_or(Value::Null, Value::from)
        }
        Value::Array(list) => list.into_iter().map(rounded).collect(),
        Value::Object(map) => map.into_iter().map(|(k, v)| (k, rounded(v))).collect(),
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_logged_survives_json() {
        let mut log = DrawLog::default();
        log.add("part", &(1.0 / 3.0, [2.0f64.sqrt() * 1e-6, f64::INFINITY], "name", 7));
        let value = log.into_value();
        assert_eq!(value["part"][0], 0.333333);
        assert_eq!(value["part"][1][1], Value::Null);
        assert_eq!(value["part"][3], 7);
        assert_eq!(serde_json::from_str::<Value>(&value.to_string()).unwrap(), value);
    }
}
