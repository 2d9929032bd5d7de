//! Clock, address pins, accelerometers.

use super::{Finding, GRAVITY_ERROR_MAX_PERCENT, HSE_ERROR_MAX_PPM, XL_RATE_ERROR_MAX_PERCENT};
use crate::board::{XlFault, XlPart};
use crate::drivers::scan::ADDRESS_LINES;
use crate::params::XL_AXES;
use crate::sensor::XlSample;

/// `found_hz`: by the HSI; 0 where nothing oscillates.
pub fn judge_clock(found_hz: u32, nominal_hz: u32) -> Finding {
    let off_ppm = u64::from(found_hz.abs_diff(nominal_hz)) * 1_000_000 / u64::from(nominal_hz.max(1));
    match found_hz {
        0 => Finding::HseAbsent,
        hz if off_ppm > u64::from(HSE_ERROR_MAX_PPM) => Finding::HseOff { hz },
        hz => Finding::HseAt { hz },
    }
}

/// What the ten pins read, line 0 in bit 0: pulled down and none driven, then with each one driven high alone.
pub fn judge_lines(idle: u16, driven: &[u16; ADDRESS_LINES as usize]) -> Finding {
    if idle != 0 {
        return Finding::LineHeld { line: idle.trailing_zeros() as u8, high: true };
    }
    for (line, &read) in driven.iter().enumerate() {
        let others = read & !(1 << line);
        if read & 1 << line == 0 {
            return Finding::LineHeld { line: line as u8, high: false };
        }
        if others != 0 {
            return Finding::LinesShorted { lines: (line as u8, others.trailing_zeros() as u8) };
        }
    }
    Finding::LinesFree
}

/// Of one accelerometer, while it lies still.
#[derive(Clone, Copy, Debug, Default)]
pub struct XlReadings {
    samples: u32,
    sums: [i64; XL_AXES],
    first: XlSample,
    changed: bool,
}

impl XlReadings {
    /// Samples of one read of the FIFO.
    pub fn add(&mut self, samples: &[XlSample]) {
        for sample in samples {
            if self.samples == 0 {
                self.first = *sample;
            }
            self.samples += 1;
            self.changed |= *sample != self.first;
            self.sums.iter_mut().zip(sample).for_each(|(sum, &axis)| *sum += i64::from(axis));
        }
    }
}

/// What `elapsed_us` brought, or why it brought nothing. `answers`: another accelerometer of the bus does.
pub fn judge_xl(
    readings: Result<XlReadings, XlFault>,
    part: XlPart,
    elapsed_us: u64,
    answers: bool,
) -> Finding {
    let readings = match readings {
        Ok(readings) => readings,
        Err(XlFault::WrongPart { found: 0, .. }) => {
            return Finding::XlNoAnswer { all_ones: false, only_one: answers };
        }
        // What is left of ones by the masks of either driver.
        Err(XlFault::WrongPart { found: 0xffff_f080 | 0xffff_f000 | 0xff, .. }) => {
            return Finding::XlNoAnswer { all_ones: true, only_one: answers };
        }
        Err(XlFault::WrongPart { expected, found }) => return Finding::XlWrong { expected, found },
        Err(fault) => return Finding::XlFault(fault),
    };
    if readings.samples == 0 {
        return Finding::XlDead;
    }
    if !readings.changed {
        return Finding::XlFrozen;
    }
    let rate_hz = (u64::from(readings.samples) * 1_000_000 / elapsed_us.max(1)) as u32;
    let nominal_hz = part.native_rate_hz;
    if rate_hz.abs_diff(nominal_hz) * 100 > nominal_hz * XL_RATE_ERROR_MAX_PERCENT {
        return Finding::XlRate { found_hz: rate_hz, nominal_hz };
    }
    let square = |sum: i64| {
        let mean = sum / i64::from(readings.samples);
        (mean * mean) as u64
    };
    let magnitude = readings.sums.map(square).iter().sum::<u64>().isqrt();
    let milli_g = (magnitude * 1000 / u64::from(part.lsb_per_g)) as u32;
    if milli_g.abs_diff(1000) > 10 * GRAVITY_ERROR_MAX_PERCENT {
        return Finding::XlGravity { milli_g };
    }
    Finding::XlAt { rate_hz, milli_g }
}
