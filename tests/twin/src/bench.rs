//! What the bring-up program meets on the desk: pads pressed all over, accelerometers at rest, and the faults of wires
//! and parts that it has to name. Sensor 0 has them. They hold for the whole run.

use clap::ValueEnum;
use slipsense::drivers::scan::COLUMN_LINES;
use slipsense::params::{TAXEL_COLS, TAXELS};
use slipsense::sensor::{XlSample, is_active};
use slipsense::transfer::IDLE_CODE;

use crate::scan_timing::FIRST_PIN;

/// Least and span of what pressed taxels read above idle, codes.
const PRESS_CODES: u64 = 8_000;
const UNEVEN_CODES: u64 = 24_000;
/// Noise is so many codes up or down at most.
const NOISE_CODES: u64 = 12;
const NOISY_CODES: u64 = 900;
const FULL_SCALE: u64 = 65_535;
/// Taxel, row and column with a fault.
const TAXEL: usize = 9 * TAXEL_COLS + 13;
const ROW: usize = 11;
const COL: usize = 20;
/// An ADXL380 at rest: 1 g in z.
const REST: XlSample = [0, 0, 7_500];
/// What is slower than the front end's two time constants as one.
pub const SLOW_TAU_NS: f64 = 600.0;
/// HSE of an RC oscillator that is off.
pub const OFF_HZ: u64 = 8_080_000;
/// A crystal for another board: the PLLs do not lock.
pub const WRONG_HZ: u64 = 16_000_000;

/// A fault of wires or parts, at sensor 0 where there is one for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DeskFault {
    /// No clock on PH0.
    HseAbsent,
    /// The clock on PH0 is 1 % fast.
    HseOff,
    /// The clock on PH0 is twice as fast.
    HseWrong,
    /// RX does not follow TX.
    NoTransceiver,
    /// Column address A3 is at ground.
    LineAtGround,
    /// Column addresses A1 and A2 are shorted.
    LinesShorted,
    /// Row address A2 is open behind the pin.
    LineOpen,
    /// Column addresses A2 and A3 are swapped.
    LinesSwapped,
    /// The wire of a row is open.
    RowOpen,
    /// The amplifier of a column is at its rail.
    ColumnHigh,
    /// The array is not plugged in.
    Unplugged,
    /// The analog line is at ground.
    ArrayShorted,
    /// One taxel feels nothing.
    TaxelDead,
    /// One taxel has no noise.
    TaxelStuck,
    /// One taxel has a loose contact.
    TaxelNoisy,
    /// Four times the time constant.
    Slow,
    /// SPI reads ones, from every part.
    MisoOpen,
    /// The chip select of the accelerometer is open.
    SelectOpen,
    /// The accelerometer is an ADXL382.
    XlWrong,
    /// The accelerometer repeats a sample.
    XlFrozen,
    /// Its oscillator is 10 % slow.
    XlSlow,
    /// It makes no samples.
    XlStops,
}

#[derive(Clone, Copy, Debug)]
pub struct Desk {
    pub sensors: usize,
    pub fault: Option<DeskFault>,
}

pub fn has(desk: Option<Desk>, fault: DeskFault) -> bool {
    desk.is_some_and(|desk| desk.fault == Some(fault))
}

/// Splitmix64's end: any mixture will do.
pub fn mix(number: u64) -> u64 {
    let word = (number ^ number >> 30).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    let word = (word ^ word >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    word ^ word >> 31
}

impl Desk {
    /// As the part of this sensor sees it.
    pub fn at(self, sensor: usize) -> Self {
        let mine = |fault: &DeskFault| sensor == 0 || *fault == DeskFault::MisoOpen;
        Self { fault: self.fault.filter(mine), ..self }
    }

    fn selected(self, address: usize) -> usize {
        match self.fault {
            Some(DeskFault::LineOpen) => address & !(1 << (COLUMN_LINES + 2)),
            Some(DeskFault::LinesSwapped) => {
                let differ = (address >> 2 ^ address >> 3) & 1;
                address ^ (differ << 2 | differ << 3)
            }
            // The low one wins.
            Some(DeskFault::LinesShorted) => address & !0b110 | (address >> 1 & address >> 2 & 1) * 0b110,
            Some(DeskFault::LineAtGround) => address & !(1 << 3),
            _ => address,
        }
    }

    pub fn code(self, frame: usize, address: usize, sensor: usize) -> u16 {
        if sensor >= self.sensors {
            return FULL_SCALE as u16;
        }
        // The lines are common.
        let taxel = self.selected(address);
        let fault = self.at(sensor).fault;
        let (row, col) = (taxel / TAXEL_COLS, taxel % TAXEL_COLS);
        let silent = fault == Some(DeskFault::RowOpen) && row == ROW
            || fault == Some(DeskFault::TaxelDead) && taxel == TAXEL;
        let pressed = is_active(row, col) && !silent;
        let press = PRESS_CODES + mix((sensor * TAXELS + taxel) as u64 + 1) % UNEVEN_CODES;
        let level = u64::from(IDLE_CODE) + if pressed { press } else { 0 };
        let noisy = fault == Some(DeskFault::TaxelNoisy) && taxel == TAXEL;
        let span = if noisy { NOISY_CODES } else { NOISE_CODES };
        let draw = mix((frame as u64) << 16 ^ (sensor * TAXELS + address) as u64) % (2 * span + 1);
        let code = match fault {
            Some(DeskFault::Unplugged) => FULL_SCALE,
            Some(DeskFault::ArrayShorted) => 0,
            Some(DeskFault::ColumnHigh) if col == COL => FULL_SCALE,
            Some(DeskFault::TaxelStuck) if taxel == TAXEL => level,
            _ => (level + draw).saturating_sub(span),
        };
        code.min(FULL_SCALE) as u16
    }

    /// Levels of port E: an output pulls the line it is shorted to, ground wins.
    pub fn pins(self, levels: u64, moder: u64) -> u64 {
        let (a, b) = (FIRST_PIN + 1, FIRST_PIN + 2);
        let drives = |pin: u32| moder >> (2 * pin) & 3 == 1;
        let high = |pin: u32| levels >> pin & 1 == 1;
        match self.fault {
            Some(DeskFault::LineAtGround) => levels & !(1 << (FIRST_PIN + 3)),
            Some(DeskFault::LinesShorted) => {
                let both = match (drives(a), drives(b)) {
                    (true, false) => high(a),
                    (false, true) => high(b),
                    _ => high(a) && high(b),
                };
                levels & !(1 << a | 1 << b) | u64::from(both) << a | u64::from(both) << b
            }
            _ => levels,
        }
    }

    pub fn sample(self, index: usize) -> XlSample {
        if self.fault == Some(DeskFault::XlFrozen) {
            return REST;
        }
        let noise = |axis: usize| (mix((3 * index + axis) as u64) % 41) as i16 - 20;
        [REST[0] + noise(0), REST[1] + noise(1), REST[2] + noise(2)]
    }
}
