//! From what the bring-up program measures to a verdict with a reason and the wire to look at. No hardware: the program
//! is `src/firmware/bin/app/bringup.rs`, the page that begins with it "First slip".

mod array;
mod board;

pub use array::{ArrayStats, Settling, judge_array, judge_settling};
pub use board::{XlReadings, judge_clock, judge_lines, judge_xl};

use core::fmt;

use crate::board::XlFault;
use crate::drivers::scan::COLUMN_LINES;
use crate::params::TAXEL_COLS;

/// Codes of one count of 12 bits.
const CODES_PER_COUNT: u32 = 16;
/// Codes above idle from which on a taxel is pressed: 38 kPa of the nominal film, 23 N on the whole pad.
pub const PRESSED_CODES: u32 = 640;
/// A smaller step says nothing of settling: what may be left is 0.6 % of it.
pub const STEP_MIN_CODES: u32 = 2_500;
/// More of rms noise is noisy: 4 counts of 12 bits.
pub const NOISE_MAX_CODES: u32 = 4 * CODES_PER_COUNT;
/// What may be left of a step when the ADC is triggered: half a count for each of the two time constants in a row.
pub const SETTLED_CODES: u32 = CODES_PER_COUNT;
/// The HSE may be off by so much against the HSI, which itself is within 5000 ppm at 30 °C (DS12110).
pub const HSE_ERROR_MAX_PPM: u32 = 8_000;
/// An accelerometer's oscillator may be off by so much, and gravity.
pub const XL_RATE_ERROR_MAX_PERCENT: u32 = 5;
/// Goes on.
pub const GRAVITY_ERROR_MAX_PERCENT: u32 = 25;

/// How a finding counts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Grade {
    Ok,
    /// Could not be judged, and why.
    Open,
    Failed,
}

/// What a check found. Codes are the ADC's, rows and columns those of the scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are, and the text says it")]
pub enum Finding {
    // The clock on PH0.
    HseAt { hz: u32 },
    HseAbsent,
    HseOff { hz: u32 },
    // The CAN controller hears itself, inside.
    CanInside,
    CanInsideSilent,
    // RX follows TX.
    Transceiver,
    NoTransceiver,
    BusDominant,
    // Another node acknowledges.
    Acknowledged,
    NotAcknowledged,
    // The address pins of the chip.
    LinesFree,
    LineHeld { line: u8, high: bool },
    LinesShorted { lines: (u8, u8) },
    // Nothing at this connector.
    NotFitted,
    XlAt { rate_hz: u32, milli_g: u32 },
    XlNoAnswer { all_ones: bool, only_one: bool },
    XlWrong { expected: u32, found: u32 },
    XlFault(XlFault),
    XlDead,
    XlFrozen,
    XlRate { found_hz: u32, nominal_hz: u32 },
    XlGravity { milli_g: u32 },
    ArrayAt { pressed: u32, noise_codes: u32 },
    ArrayUnplugged,
    ArrayShorted,
    ArrayFixed { code: u16 },
    NotPressed,
    RowSilent { row: u8 },
    RowHigh { row: u8 },
    ColSilent { col: u8 },
    ColHigh { col: u8 },
    AddressOpen { line: u8 },
    AddressSwapped { lines: (u8, u8) },
    OutsidePad { taxels: u32 },
    TaxelsStuck { taxels: u32, first: u16 },
    TaxelsDead { taxels: u32, first: u16 },
    TaxelsNoisy { taxels: u32, first: u16, codes: u32 },
    Settled { left_codes: u32, step_codes: u32 },
    NotSettled { left_codes: u32, step_codes: u32 },
}

impl Finding {
    /// How it counts.
    pub const fn grade(self) -> Grade {
        match self {
            Self::HseAt { .. } | Self::CanInside | Self::Transceiver | Self::Acknowledged => Grade::Ok,
            Self::LinesFree | Self::XlAt { .. } | Self::ArrayAt { .. } | Self::Settled { .. } => Grade::Ok,
            Self::NotFitted | Self::NotPressed | Self::NotAcknowledged => Grade::Open,
            _ => Grade::Failed,
        }
    }
}

/// An address line as the wiring page names it; PE2 is the lowest (`firmware/bin/app/pins.rs`).
fn line_name(line: u8) -> impl fmt::Display {
    let columns = COLUMN_LINES as u8;
    let (what, number) = if line < columns { ("column", line) } else { ("row", line - columns) };
    fmt::from_fn(move |f| write!(f, "{what} A{number} (PE{})", line + 2))
}

/// A taxel of the scan.
fn taxel_name(taxel: u16) -> impl fmt::Display {
    let taxel = usize::from(taxel);
    fmt::from_fn(move |f| write!(f, "row {} column {}", taxel / TAXEL_COLS, taxel % TAXEL_COLS))
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::HseAt { hz } => write!(f, "PH0 has {hz} Hz by the HSI"),
            Self::HseAbsent => f.write_str("no clock on PH0: USB into CN1, or the ST-LINK's MCO is off"),
            Self::HseOff { hz } => {
                write!(f, "PH0 has {hz} Hz by the HSI: the ST-LINK's RC oscillator? Fit a crystal")
            }
            Self::CanInside => f.write_str("the controller hears itself"),
            Self::CanInsideSilent => f.write_str("the controller does not hear itself: its kernel clock"),
            Self::Transceiver => f.write_str("RX follows TX"),
            Self::NoTransceiver => f.write_str(
                "RX (PD0) does not follow TX (PD1): no transceiver, no supply, standby, or TXD or RXD open",
            ),
            Self::BusDominant => {
                f.write_str("RX (PD0) stays low: RXD shorted, or CANH and CANL held dominant")
            }
            Self::Acknowledged => f.write_str("another node acknowledges"),
            Self::NotAcknowledged => {
                f.write_str("nobody acknowledges: no second node, another bit rate, CANH or CANL open")
            }
            Self::LinesFree => f.write_str("ten pins, none held, none shorted"),
            Self::LineHeld { line, high } => {
                let rail = if high { "3.3 V" } else { "ground" };
                write!(f, "{} is held at {rail}: a short at the pin or in the cable", line_name(line))
            }
            Self::LinesShorted { lines: (a, b) } => {
                write!(f, "{} and {} are shorted: solder, cable", line_name(a), line_name(b))
            }
            Self::NotFitted => f.write_str("neither array nor accelerometer at this connector"),
            Self::XlAt { rate_hz, milli_g } => write!(f, "{rate_hz} samples/s, {milli_g} mg at rest"),
            Self::XlNoAnswer { all_ones, only_one } => {
                let level = if all_ones { "ones" } else { "zeros" };
                let wire =
                    if only_one { "its chip select or supply" } else { "MISO (PA6), SCK, MOSI or supply" };
                write!(f, "its identifier reads all {level}: {wire}")
            }
            Self::XlWrong { expected, found } => {
                write!(
                    f,
                    "identifier {found:#x}, expected {expected:#x}: another part, or build for this one"
                )
            }
            Self::XlFault(fault) => write!(f, "{fault}: SCK or MOSI disturbed"),
            Self::XlDead => f.write_str("answers, but samples nothing: its supply, or the part"),
            Self::XlFrozen => f.write_str("all samples are equal: the part"),
            Self::XlRate { found_hz, nominal_hz } => {
                write!(f, "{found_hz} samples/s, nominal {nominal_hz}: the part, or the clock on PH0")
            }
            Self::XlGravity { milli_g } => {
                write!(f, "{milli_g} mg at rest: it moves, or an axis is broken")
            }
            Self::ArrayAt { pressed, noise_codes } => {
                write!(f, "{pressed} taxels pressed, noise {noise_codes} codes rms at most")
            }
            Self::ArrayUnplugged => {
                f.write_str("all codes at full scale: unplugged, or the analog line open")
            }
            Self::ArrayShorted => {
                f.write_str("all codes at 0: the analog line at ground, amplifier unsupplied")
            }
            Self::ArrayFixed { code } => write!(f, "always {code}: the ADC pin follows no amplifier"),
            Self::NotPressed => f.write_str("hardly pressed: press the whole pad and reset"),
            Self::RowSilent { row } => write!(f, "row {row} stays idle under pressure: row driver, row wire"),
            Self::RowHigh { row } => write!(f, "row {row} at full scale: row shorted to its drive level"),
            Self::ColSilent { col } => {
                write!(f, "column {col} stays idle under pressure: column wire, its amplifier")
            }
            Self::ColHigh { col } => write!(f, "column {col} at full scale: column shorted, its amplifier"),
            Self::AddressOpen { line } => {
                write!(f, "{} changes nothing: open behind the pin", line_name(line))
            }
            Self::AddressSwapped { lines: (a, b) } => {
                write!(f, "{} and {} are swapped", line_name(a), line_name(b))
            }
            Self::OutsidePad { taxels } => {
                write!(
                    f,
                    "{taxels} taxels pressed where the pad has none: several lines wrong, or mounted turned"
                )
            }
            Self::TaxelsStuck { taxels, first } => {
                write!(f, "{taxels} taxels without any noise, the first at {}", taxel_name(first))
            }
            Self::TaxelsDead { taxels, first } => {
                write!(f, "{taxels} taxels idle among pressed ones, the first at {}", taxel_name(first))
            }
            Self::TaxelsNoisy { taxels, first, codes } => write!(
                f,
                "{taxels} taxels noisy, {codes} codes rms at {}: a loose contact, the shield",
                taxel_name(first)
            ),
            Self::Settled { left_codes, step_codes } => {
                write!(f, "{left_codes} codes of a step of {step_codes} are left at the trigger")
            }
            Self::NotSettled { left_codes, step_codes } => write!(
                f,
                "{left_codes} codes of a step of {step_codes} are left at the trigger: capacitance, cable, amplifier"
            ),
        }
    }
}

/// A check and what it found, as a line of the log and a record on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "the fields are named after what they are")]
pub struct Verdict {
    pub check: &'static str,
    /// Connector, where there is one for each sensor.
    pub sensor: Option<usize>,
    pub finding: Finding,
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let grade = match self.finding.grade() {
            Grade::Ok => "OK",
            Grade::Open => "OPEN",
            Grade::Failed => "FAILED",
        };
        match self.sensor {
            Some(sensor) => write!(f, "{grade} {} {sensor}: {}", self.check, self.finding),
            None => write!(f, "{grade} {}: {}", self.check, self.finding),
        }
    }
}

/// The last line: `all OK` without a fault, `failed N` with the first of them.
#[derive(Clone, Copy, Debug)]
pub struct Summary<'a>(pub &'a [Verdict]);

impl Summary<'_> {
    /// Checks of this grade.
    pub fn count(&self, grade: Grade) -> usize {
        self.0.iter().filter(|verdict| verdict.finding.grade() == grade).count()
    }
}

impl fmt::Display for Summary<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (failed, open) = (self.count(Grade::Failed), self.count(Grade::Open));
        match self.0.iter().find(|verdict| verdict.finding.grade() == Grade::Failed) {
            Some(first) => write!(f, "verdict: {failed} failed, the first: {first}"),
            None if open > 0 => write!(f, "verdict: OK, {open} not judged"),
            None => f.write_str("verdict: OK"),
        }
    }
}
