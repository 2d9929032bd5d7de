//! A test stand's exported table of readings: time, travel and, where it has one, load.
//!
//! Made for the CSV of Mark-10 stands and tolerant to how programs save it again: lines before the table,
//! comma, semicolon or tab, decimal comma, units in brackets, in words or in a row of their own.

use std::fmt::Display;
use std::path::Path;

use csv::{ReaderBuilder, StringRecord};
use slipsense::params::FRAME_RATE_HZ;

use super::LabelError;
use super::header::{Column, LOAD, Quantity, TIME, TRAVEL};
use super::rule::ENCODER_STEP_MM;

/// A pause between readings longer than this (s), in which the crosshead moved, hides an onset.
const GAP_S: f64 = 0.2;
/// Lines in which a header is looked for.
const HEADER_LINES: usize = 200;
const SEPARATORS: [u8; 3] = [b';', b'\t', b','];

fn wrong_line(line: u64, rule: impl Display) -> LabelError {
    LabelError(format!("line {line}: {rule}"))
}

/// Readings of a test stand, at least two, in order of time.
#[derive(Clone, Debug, PartialEq)]
pub struct StandLog {
    /// The stand's clock, s; never goes back.
    pub time_s: Vec<f64>,
    /// Position of the crosshead, mm; one per reading.
    pub travel_mm: Vec<f64>,
    /// Force on the load cell, N; one per reading.
    pub load_n: Option<Vec<f64>>,
    /// Titles of the columns that were read, as in the file.
    pub columns: Vec<String>,
    /// Those of them without a unit: taken as mm, s and N.
    pub without_unit: Vec<String>,
    /// Line of each reading, from 1.
    lines: Vec<u64>,
}

/// A log brought to the frames of a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct AtFrames {
    /// Position of the crosshead at each frame's tick, mm, interpolated between readings.
    pub displacement_mm: Vec<f32>,
    /// Frames before the first or after the last reading, for which its position is held.
    pub held_frames: usize,
}

impl StandLog {
    pub fn read(path: impl AsRef<Path>) -> Result<Self, LabelError> {
        let path = path.as_ref();
        let named = |rule: String| LabelError(format!("{}: {rule}", path.display()));
        let bytes = std::fs::read(path).map_err(|error| named(format!("cannot read: {error}")))?;
        // Names in the lines before the table may be in any encoding.
        Self::parse(&String::from_utf8_lossy(&bytes)).map_err(|LabelError(rule)| named(rule))
    }

    pub fn parse(text: &str) -> Result<Self, LabelError> {
        let text = text.trim_start_matches('\u{feff}');
        let table = Table::find(text)?;
        let mut log = Self {
            time_s: Vec::new(),
            travel_mm: Vec::new(),
            load_n: table.load.as_ref().map(|_| Vec::new()),
            columns: table.columns().map(|column| column.title.clone()).collect(),
            without_unit: table.columns().filter(|c| c.unit_assumed).map(|c| c.title.clone()).collect(),
            lines: Vec::new(),
        };
        for row in rows(table.body, table.separator) {
            let row = row.map_err(|error| wrong_line(table.first_line, error))?;
            let line = table.line(&row);
            if row.iter().all(|cell| cell.trim().is_empty()) {
                continue;
            }
            table.check_width(&row, line)?;
            let time_s = number(&row, &table.time, line)?;
            if log.time_s.last().is_some_and(|&before| time_s < before) {
                return Err(table.time.refuse(&row, line, "must not be before the reading above"));
            }
            log.time_s.push(time_s);
            log.travel_mm.push(number(&row, &table.travel, line)?);
            if let (Some(column), Some(load_n)) = (&table.load, &mut log.load_n) {
                load_n.push(number(&row, column, line)?);
            }
            log.lines.push(line);
        }
        if log.time_s.len() < 2 || log.span_s() <= 0.0 {
            let rule =
                format!("{} readings follow, must be at least two at different times", log.time_s.len());
            return Err(wrong_line(table.first_line, rule));
        }
        log.check_gaps()?;
        Ok(log)
    }

    pub fn rate_hz(&self) -> f64 {
        (self.time_s.len() - 1) as f64 / self.span_s()
    }

    fn span_s(&self) -> f64 {
        self.time_s.last().unwrap_or(&0.0) - self.time_s.first().unwrap_or(&0.0)
    }

    fn check_gaps(&self) -> Result<(), LabelError> {
        for i in 1..self.time_s.len() {
            let pause_s = self.time_s[i] - self.time_s[i - 1];
            let moved_mm = (self.travel_mm[i] - self.travel_mm[i - 1]).abs();
            if pause_s > GAP_S && moved_mm > 1.5 * ENCODER_STEP_MM {
                let rule = format!(
                    "{pause_s:.2} s after the reading above, and the crosshead moved {moved_mm:.2} mm: readings \
                     must be at most {GAP_S} s apart while it moves"
                );
                return Err(wrong_line(self.lines[i], rule));
            }
        }
        Ok(())
    }

    /// Position at the tick of each frame; frame f ends (f + 1) / 240 s after the recording began, when the
    /// stand's clock showed `offset_s`. Where there is no reading the position is held, if the crosshead
    /// stood there or no more than one reading is missing.
    pub fn at_frames(&self, frames: usize, offset_s: f64) -> Result<AtFrames, LabelError> {
        let clock_s = |frame: usize| (frame as f64 + 1.0) / f64::from(FRAME_RATE_HZ) + offset_s;
        let (first_s, last_s) = (self.time_s[0], self.time_s[0] + self.span_s());
        let before = (0..frames).take_while(|&f| clock_s(f) < first_s).count();
        let after = (0..frames).rev().take_while(|&f| clock_s(f) > last_s).count();
        let on_clock =
            format!("the recording lasts from {offset_s:.3} s to {:.3} s on its clock", clock_s(frames - 1));
        if before == frames || after == frames {
            return Err(LabelError(format!("covers {first_s:.3} s to {last_s:.3} s, but {on_clock}")));
        }
        for (missing, edge_s, what) in [(before, first_s, "first"), (after, last_s, "last")] {
            // Up to one reading more would have come: that is no further than any frame from the next one.
            let missing_s = missing as f64 / f64::from(FRAME_RATE_HZ);
            if missing_s > 1.0 / self.rate_hz() && self.moves_near(edge_s) {
                return Err(LabelError(format!(
                    "the crosshead moves at the {what} reading ({edge_s:.3} s), must stand there: {on_clock}"
                )));
            }
        }
        let displacement_mm = (0..frames).map(|f| self.travel_at(clock_s(f)) as f32).collect();
        Ok(AtFrames { displacement_mm, held_frames: before + after })
    }

    fn moves_near(&self, time_s: f64) -> bool {
        let near = self.time_s.iter().zip(&self.travel_mm).filter(|(t, _)| (**t - time_s).abs() <= GAP_S);
        let (low, high) =
            near.fold((f64::MAX, f64::MIN), |(low, high), (_, &mm)| (low.min(mm), high.max(mm)));
        high - low > 1.5 * ENCODER_STEP_MM
    }

    /// Interpolated position, mm; the first and last reading's beyond them.
    fn travel_at(&self, time_s: f64) -> f64 {
        let next = self.time_s.partition_point(|&t| t <= time_s);
        if next == 0 || next == self.time_s.len() {
            return self.travel_mm[next.saturating_sub(1)];
        }
        let (t0, t1) = (self.time_s[next - 1], self.time_s[next]);
        let (mm0, mm1) = (self.travel_mm[next - 1], self.travel_mm[next]);
        mm0 + (mm1 - mm0) * (time_s - t0) / (t1 - t0)
    }
}

/// Where the table is and which columns it has.
struct Table<'t> {
    separator: u8,
    width: usize,
    time: Column,
    travel: Column,
    load: Option<Column>,
    /// Text from the first reading on, and its line.
    body: &'t str,
    first_line: u64,
}

impl<'t> Table<'t> {
    fn find(text: &'t str) -> Result<Self, LabelError> {
        let mut rest = text;
        for line in 1..=HEADER_LINES as u64 {
            let Some((header, body)) = rest.split_once('\n') else { break };
            for separator in SEPARATORS {
                if let Some(table) = Self::under(header, body, separator, line)? {
                    return Ok(table);
                }
            }
            rest = body;
        }
        Err(LabelError(format!(
            "no line of the first {HEADER_LINES} names the columns, must hold one for time and one for travel, such \
             as \"Reading,Load [N],Travel [mm],Time [sec]\""
        )))
    }

    /// The table under this line, if it names the columns.
    fn under(header: &str, body: &'t str, separator: u8, line: u64) -> Result<Option<Self>, LabelError> {
        let Some(titles) = one_row(header, separator) else { return Ok(None) };
        let (below, after) = body.split_once('\n').unwrap_or((body, ""));
        let units = one_row(below, separator).filter(|row| row.iter().all(|cell| parse(cell).is_none()));
        let column = |quantity: Quantity| {
            quantity.find(&titles, units.as_ref()).map_err(|rule| wrong_line(line, rule))
        };
        // Only a line that names both is the header; then a unit that is not known is an error.
        let absent = |quantity: Quantity| matches!(quantity.find(&titles, None), Ok(None));
        if absent(TIME) || absent(TRAVEL) {
            return Ok(None);
        }
        let (Some(time), Some(travel)) = (column(TIME)?, column(TRAVEL)?) else { return Ok(None) };
        let load = column(LOAD)?;
        let (body, first_line) = if units.is_some() { (after, line + 2) } else { (body, line + 1) };
        Ok(Some(Self { separator, width: titles.len(), time, travel, load, body, first_line }))
    }

    fn columns(&self) -> impl Iterator<Item = &Column> {
        [&self.time, &self.travel].into_iter().chain(&self.load)
    }

    /// Line of a row of the body, from 1 in the file. The reader's position is before what it skips: blank
    /// lines, and the second half of a line's end.
    fn line(&self, row: &StringRecord) -> u64 {
        let (byte, line) = row.position().map_or((0, 1), |at| (at.byte() as usize, at.line()));
        let skipped =
            self.body.bytes().skip(byte).take_while(|b| b"\r\n".contains(b)).filter(|b| *b == b'\n');
        self.first_line + line - 1 + skipped.count() as u64
    }

    fn check_width(&self, row: &StringRecord, line: u64) -> Result<(), LabelError> {
        let last = row.iter().rev().position(|cell| !cell.trim().is_empty());
        let filled = last.map_or(0, |empty| row.len() - empty);
        if filled <= self.width {
            return Ok(());
        }
        let rule = format!(
            "{filled} cells, must be {} as in the header; where numbers have decimal commas, cells must be \
             separated by semicolons or tabs",
            self.width
        );
        Err(wrong_line(line, rule))
    }
}

impl Column {
    fn refuse(&self, row: &StringRecord, line: u64, rule: &str) -> LabelError {
        let value: String = row.get(self.at).unwrap_or_default().trim().chars().take(40).collect();
        LabelError(format!("line {line}, column {:?}: is {value:?}, {rule}", self.title))
    }
}

fn rows(text: &str, separator: u8) -> impl Iterator<Item = csv::Result<StringRecord>> {
    let reader = ReaderBuilder::new()
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .from_reader(text.as_bytes());
    reader.into_records()
}

fn one_row(line: &str, separator: u8) -> Option<StringRecord> {
    rows(line, separator).next().and_then(Result::ok)
}

fn number(row: &StringRecord, column: &Column, line: u64) -> Result<f64, LabelError> {
    let value = parse(row.get(column.at).unwrap_or_default());
    value.map(|value| value * column.factor).ok_or_else(|| column.refuse(row, line, "must be a number"))
}

/// A finite number with a decimal point or comma and no thousands separators.
fn parse(cell: &str) -> Option<f64> {
    let cell = cell.trim().replace('\u{2212}', "-");
    let cell = if cell.contains('.') { cell } else { cell.replacen(',', ".", 1) };
    cell.parse::<f64>().ok().filter(|value| value.is_finite())
}
