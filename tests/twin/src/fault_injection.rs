//! What happens to bus and sensors during a run, and when.

use std::ops::Range;

use slipsense_can_sim::RECOVERY_BITS;

/// Name on the command line and what it is.
pub const NAMES: [(&str, Kind); 9] = [
    ("off", Kind::NoAcknowledge),
    ("jam", Kind::ErrorFrames { per_million: 1_000_000 }),
    ("errors1", Kind::ErrorFrames { per_million: 10_000 }),
    ("errors10", Kind::ErrorFrames { per_million: 100_000 }),
    ("flood", Kind::Flood),
    ("hostile", Kind::Hostile),
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
    /// Another node wants of the board, frame after frame, what a locked one must refuse: see [`crate::fdcan::hostile`].
    Hostile,
    /// Every accelerometer's oscillator stands.
    AccelerometerStops,
    /// Every accelerometer makes samples four times as fast: its FIFO is full before it is read.
    FifoOverrun,
    /// The ADC's input does not follow the address.
    AdcStuck,
}

impl Kind {
    /// Nothing that the board sends arrives meanwhile.
    pub fn takes_the_bus(self) -> bool {
        matches!(self, Self::NoAcknowledge | Self::ErrorFrames { per_million: 1_000_000 })
    }

    /// Nanoseconds after it in which the board may still be off the bus: as long as recovery takes, at 1 Mbit/s. Whether
    /// it is depends on where the end falls between two attempts.
    pub fn recovery_ns(self) -> u64 {
        let destroys_all = self == Self::ErrorFrames { per_million: 1_000_000 };
        if destroys_all { RECOVERY_BITS * 1_000 } else { 0 }
    }
}

/// A fault and when, in virtual nanoseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    pub name: &'static str,
    pub kind: Kind,
    /// From and to.
    pub when: Range<u64>,
}

impl Fault {
    /// Of the same kind and duration.
    pub fn is_like(&self, other: &Self) -> bool {
        let lasts = |fault: &Self| fault.when.end - fault.when.start;
        self.kind == other.kind && lasts(self) == lasts(other)
    }
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

/// The faults of a run. Each taxel that is converted asks which are active, so an hour of them must not take longer.
#[derive(Clone, Debug, Default)]
pub struct Faults {
    by_start: Vec<Fault>,
    longest_ns: u64,
}

impl Faults {
    pub fn new(mut faults: Vec<Fault>) -> Self {
        faults.sort_by_key(|fault| fault.when.start);
        let longest_ns = faults.iter().map(|fault| fault.when.end - fault.when.start).max().unwrap_or(0);
        Self { by_start: faults, longest_ns }
    }

    /// By their start.
    pub fn all(&self) -> &[Fault] {
        &self.by_start
    }

    /// Those that start later.
    pub fn after(&self, now_ns: u64) -> &[Fault] {
        &self.by_start[self.by_start.partition_point(|fault| fault.when.start <= now_ns)..]
    }

    pub fn active(&self, now_ns: u64) -> impl Iterator<Item = Kind> + '_ {
        let started = &self.by_start[..self.by_start.len() - self.after(now_ns).len()];
        let lasts = move |fault: &&Fault| fault.when.start + self.longest_ns > now_ns;
        let recent = started.iter().rev().take_while(lasts);
        recent.filter(move |fault| fault.when.contains(&now_ns)).map(|fault| fault.kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn active_is_what_has_begun_and_not_ended() {
        let spans = [(40, 50), (0, 100), (10, 20), (45, 46)];
        let fault = |(start, end)| Fault { name: "flood", kind: Kind::Flood, when: start..end };
        let faults = Faults::new(spans.map(fault).into());
        for now_ns in 0..120 {
            let expected = spans.iter().filter(|(start, end)| (*start..*end).contains(&now_ns)).count();
            assert_eq!(faults.active(now_ns).count(), expected, "at {now_ns}");
            let expected = spans.iter().filter(|(start, _)| *start > now_ns).count();
            assert_eq!(faults.after(now_ns).len(), expected, "after {now_ns}");
        }
    }
}
