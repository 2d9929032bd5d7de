//! How many samples an accelerometer has made since start, also while nobody could read them.

/// Shortest stretch over which the rate is measured, µs. One sample more or less in it is 125 ppm at 8 kHz.
const WINDOW_US: u64 = 1_000_000;
/// A part's oscillator is off by 1 to 3 %; a measured rate beyond 5 % is none.
const TOLERANCE_PERCENT: u64 = 5;

/// Counts the samples of one part, in its native rate.
///
/// While reads follow each other without a gap the count is the number of samples read, and the part's rate is measured
/// over stretches of a second, because its oscillator is its own. Over a gap the count is carried on by that rate: off
/// by at most one sample plus 125 ppm of the gap where the rate was measured, and up to 3 % where it never was.
#[derive(Clone, Copy, Debug)]
pub struct SampleCount {
    nominal_hz: u32,
    /// Samples in 1000 s.
    rate_mhz: u64,
    /// At the last read without a gap before it: time, count.
    anchor: Option<(u64, u64)>,
    /// Where the stretch begins that measures the rate.
    window: (u64, u64),
    total: u64,
    delivered: u64,
}

impl SampleCount {
    /// For a part of this nominal rate.
    pub const fn new(nominal_hz: u32) -> Self {
        Self {
            nominal_hz,
            rate_mhz: nominal_hz as u64 * 1000,
            anchor: None,
            window: (0, 0),
            total: 0,
            delivered: 0,
        }
    }

    /// Made since the first call of either function below.
    pub const fn total(&self) -> u64 {
        self.total
    }

    /// Made, but never read.
    pub const fn lost(&self) -> u64 {
        self.total - self.delivered
    }

    /// The part's rate as measured, or its nominal one, 1/1000 Hz.
    pub const fn rate_mhz(&self) -> u64 {
        self.rate_mhz
    }

    /// `samples` were read at `now_us`, the ones that follow those of the read before.
    pub fn read(&mut self, now_us: u64, samples: u32) {
        let begins = self.anchor.is_none();
        self.total += samples as u64;
        self.delivered += samples as u64;
        self.anchor = Some((now_us, self.total));
        let (from_us, from) = self.window;
        let elapsed_us = now_us.saturating_sub(from_us);
        if begins {
            self.window = (now_us, self.total);
        } else if elapsed_us >= WINDOW_US {
            let rate_mhz = ((self.total - from) * 1_000_000_000 + elapsed_us / 2) / elapsed_us;
            let nominal_mhz = self.nominal_hz as u64 * 1000;
            if rate_mhz.abs_diff(nominal_mhz) * 100 <= nominal_mhz * TOLERANCE_PERCENT {
                self.rate_mhz = rate_mhz;
            }
            self.window = (now_us, self.total);
        }
    }

    /// Nothing was read at `now_us`, or it does not follow what was read before.
    pub fn missed(&mut self, now_us: u64) {
        let (anchor_us, anchor) = *self.anchor.get_or_insert((now_us, self.total));
        // Within 2^64 for gaps of more than a month.
        let elapsed_us = now_us.saturating_sub(anchor_us);
        let passed = (elapsed_us as u128 * self.rate_mhz as u128 + 500_000_000) / 1_000_000_000;
        self.total = self.total.max(anchor + passed as u64);
        self.window = (now_us, self.total);
    }

    /// `samples` were read at `now_us`, the first after a gap: the last of them is the newest that the part has made,
    /// and at least `lost` were made between them and the read before.
    pub fn resume(&mut self, now_us: u64, samples: u32, lost: u32) {
        let before = self.anchor.map_or(0, |(_, count)| count);
        self.missed(now_us);
        if lost > 0 {
            self.total = self.total.max(before + samples as u64 + lost as u64);
        }
        // Some may have been made before a tick that could not read them.
        self.delivered += samples as u64;
        self.total = self.total.max(self.delivered);
        self.anchor = Some((now_us, self.total));
        self.window = (now_us, self.total);
    }
}
