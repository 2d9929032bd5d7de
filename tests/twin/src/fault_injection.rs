//! What happens to bus and sensors during a run, and when.

use std::ops::Range;

/// Name on the command line and what it is.
pub const NAMES: [(&str, Kind); 8] = [
    ("off", Kind::NoAcknowledge),
    ("jam", Kind::ErrorFrames { per_million: 1_000_000 }),
    ("errors1", Kind::ErrorFrames { per_million: 10_000 }),
    ("errors10", Kind::ErrorFrames { per_million: 100_000 }),
    ("flood", Kind::Flood),
    ("xl-stops", Kind::AccelerometerStops),
    ("xl-overrun", Kind::FifoOverrun),
    ("adc-stuck", Kind::AdcStuck),
];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Nobody acknowledges: cable off, or no other node.
    NoAcknowledge,
    /// One bit of this many frames in a million arrives wrong.
    ErrorFrames { per_million: u32 },
    /// Another node sends full frames, one after the other, of a priority above the raw frames'.
    Flood,
    /// Every accelerometer's oscillator stands.
    AccelerometerStops,
    /// Every accelerometer makes samples four times as fast: its FIFO is full before it is read.
    FifoOverrun,
    /// The ADC's input does not follow the address.
    AdcStuck,
}

/// A fault and when, in virtual nanoseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    pub name: &'static str,
    pub kind: Kind,
    /// From and to.
    pub when: Range<u64>,
}

/// NAME:FROM-TO.
pub fn parse(text: &str) -> Result<Fault, String> {
    let names = || NAMES.map(|(name, _)| name).join(", ");
    let (name, span) = text.split_once(':').ok_or("need NAME:FROM-TO, for example off:0.5-1.5")?;
    let (name, kind) =
        *NAMES.iter().find(|(known, _)| *known == name).ok_or(format!("{name}: need one of {}", names()))?;
    let (from, to) = span.split_once('-').ok_or("need FROM-TO in seconds after the colon")?;
    let ns = |text: &str| match text.parse::<f64>() {
        Ok(seconds) if (0.0..=36_000.0).contains(&seconds) => Ok((seconds * 1e9) as u64),
        _ => Err(format!("{text}: need seconds, 0 to 36000")),
    };
    let when = ns(from)?..ns(to)?;
    if when.is_empty() {
        return Err("the end must come after the beginning".to_owned());
    }
    Ok(Fault { name, kind, when })
}

pub fn active(faults: &[Fault], now_ns: u64) -> impl Iterator<Item = Kind> + '_ {
    faults.iter().filter(move |fault| fault.when.contains(&now_ns)).map(|fault| fault.kind)
}
