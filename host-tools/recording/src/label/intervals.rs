//! Slip intervals that a person names, in seconds from the start of the recording.

use std::ops::Range;
use std::str::FromStr;

use slipsense::params::FRAME_RATE_HZ;

use super::LabelError;

/// Slip intervals (start, end) in seconds, in order, not overlapping, none empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Intervals(Vec<(f64, f64)>);

/// Which interval, from 0, breaks a rule, and which.
fn wrong(index: usize, text: &str, rule: &str) -> LabelError {
    LabelError(format!("interval {} (\"{text}\") {rule}", index + 1))
}

impl FromStr for Intervals {
    type Err = LabelError;

    /// `START:END[,START:END…]`, such as `3.2:4.75,8:9.5`.
    fn from_str(text: &str) -> Result<Self, LabelError> {
        let mut intervals: Vec<(f64, f64)> = Vec::new();
        for (index, text) in text.split(',').enumerate() {
            let fail = |rule: &str| wrong(index, text.trim(), rule);
            let number = |text: &str| text.trim().parse::<f64>().ok().filter(|s| s.is_finite() && *s >= 0.0);
            let ends = text.split_once(':').and_then(|(start, end)| number(start).zip(number(end)));
            let (start, end) = ends.ok_or_else(|| fail("must be START:END in seconds, such as 3.2:4.75"))?;
            if start >= end {
                return Err(fail("must start before it ends"));
            }
            if intervals.last().is_some_and(|&(_, before)| start < before) {
                return Err(fail("must not begin before the end of the one before it"));
            }
            intervals.push((start, end));
        }
        Ok(Self(intervals))
    }
}

impl Intervals {
    /// In frames, ends rounded to the nearest one; an interval beyond the recording is refused.
    pub fn frames(&self, frames: usize) -> Result<Vec<Range<usize>>, LabelError> {
        let rate_hz = f64::from(FRAME_RATE_HZ);
        let one = |(index, &(start_s, end_s)): (usize, &(f64, f64))| {
            let fail = |rule: &str| wrong(index, &format!("{start_s}:{end_s}"), rule);
            let (start, end) = ((start_s * rate_hz).round() as usize, (end_s * rate_hz).round() as usize);
            if end > frames {
                let length_s = frames as f64 / rate_hz;
                return Err(fail(&format!("must end within the recording's {length_s:.3} s")));
            }
            if start == end {
                return Err(fail("must be at least one frame (1/240 s) long"));
            }
            Ok(start..end)
        };
        self.0.iter().enumerate().map(one).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_become_frames() {
        let intervals: Intervals = "0.5:1, 2:2.25".parse().unwrap();
        assert_eq!(intervals.frames(540).unwrap(), [120..240, 480..540]);
        let error = intervals.frames(539).unwrap_err().to_string();
        assert_eq!(error, "interval 2 (\"2:2.25\") must end within the recording's 2.246 s");
    }

    #[test]
    fn what_is_no_interval_is_refused_by_number() {
        for (text, error) in [
            ("", "interval 1 (\"\") must be START:END in seconds, such as 3.2:4.75"),
            ("1:2,3", "interval 2 (\"3\") must be START:END in seconds, such as 3.2:4.75"),
            ("-1:2", "interval 1 (\"-1:2\") must be START:END in seconds, such as 3.2:4.75"),
            ("2:1", "interval 1 (\"2:1\") must start before it ends"),
            ("1:3,2:4", "interval 2 (\"2:4\") must not begin before the end of the one before it"),
        ] {
            assert_eq!(text.parse::<Intervals>().unwrap_err().to_string(), error);
        }
        let short: Intervals = "1:1.001".parse().unwrap();
        assert!(short.frames(999).unwrap_err().to_string().contains("at least one frame"));
    }
}
