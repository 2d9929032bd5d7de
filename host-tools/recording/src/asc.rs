//! Vector's ASC text. Reader and writer are our own: those of the crate `blf_asc` panic on lines cut short, and write
//! the time that all others count from in milliseconds, so that every absolute time is off by the rest.

use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use crate::candump::LogEntry;
use anyhow::{Context, Result, bail, ensure};
use chrono::{Local, NaiveDateTime, TimeZone};
use slipsense::wire::{CanFrame, FD_LENGTHS};

use crate::log_file::Recording;
use crate::vector::{channel, lost_names};

/// How programs write the date, with its day of the week taken off.
const DATES: [&str; 4] =
    ["%b %d %I:%M:%S%.f %p %Y", "%b %d %H:%M:%S%.f %Y", "%b %d %I:%M:%S %p %Y", "%b %d %H:%M:%S %Y"];

pub(crate) fn read(path: &Path) -> Result<Recording> {
    let mut recording = Recording::default();
    let (mut start_us, mut skipped) = (None, 0);
    let mut input = BufReader::new(File::open(path).context("cannot read")?);
    let mut buffer = Vec::new();
    for number in 1.. {
        buffer.clear();
        if input.read_until(b'\n', &mut buffer)? == 0 {
            break;
        }
        let line = String::from_utf8_lossy(&buffer);
        let words: Vec<&str> = line.split_whitespace().collect();
        let at = || format!("line {number}");
        match words[..] {
            ["date", _, ref date @ ..] => start_us = Some(parse_date(&date.join(" ")).with_context(at)?),
            ["base", base, ..] if base != "hex" => bail!("{}: base {base}, must be hex", at()),
            ["base", _, "timestamps", kind, ..] if kind != "absolute" => {
                bail!("{}: timestamps {kind}, must be absolute", at())
            }
            [time, "CANFD", ref rest @ ..] => {
                let start_us = start_us.with_context(|| format!("{}: no date line before it", at()))?;
                match frame(rest).with_context(at)? {
                    Some((channel, frame)) => recording.entries.push(LogEntry {
                        timestamp_us: start_us + micros(time).with_context(at)?,
                        interface: format!("can{channel}"),
                        frame,
                    }),
                    None => skipped += 1,
                }
            }
            [time, _, _, _, "d" | "r", ..] if micros(time).is_ok() => skipped += 1,
            _ => {}
        }
    }
    ensure!(start_us.is_some(), "not an ASC file: no date line");
    recording.note_skipped(skipped);
    Ok(recording)
}

fn parse_date(text: &str) -> Result<u64> {
    let date = DATES.iter().find_map(|format| NaiveDateTime::parse_from_str(text, format).ok());
    let local = date.and_then(|date| Local.from_local_datetime(&date).earliest());
    let us = local.and_then(|date| u64::try_from(date.timestamp_micros()).ok());
    us.with_context(|| format!("date \"{text}\": need such as \"Nov 14 22:13:20.004 2023\""))
}

/// Seconds with a fraction to microseconds, without a float.
fn micros(text: &str) -> Result<u64> {
    let (seconds, fraction) = text.split_once('.').unwrap_or((text, ""));
    let digits: String = fraction.chars().chain("000000".chars()).take(6).collect();
    let value = |text: &str| text.parse::<u64>().ok().filter(|_| text.bytes().all(|b| b.is_ascii_digit()));
    let us = value(seconds).and_then(|s| s.checked_mul(1_000_000)?.checked_add(value(&digits)?));
    us.with_context(|| format!("time \"{text}\": need seconds"))
}

/// Channel and frame after `CANFD`; `None`: legal, but none of ours.
fn frame(words: &[&str]) -> Result<Option<(u16, CanFrame)>> {
    let [channel, _direction, id, rest @ ..] = words else { bail!("need channel, direction, identifier") };
    let channel: u16 =
        channel.parse().ok().filter(|&channel| channel > 0).context("channel must be above 0")?;
    let Some(id) = id.strip_suffix('x') else { return Ok(None) };
    let id =
        u32::from_str_radix(id, 16).ok().with_context(|| format!("identifier \"{id}\": need hexadecimal"))?;
    // A symbolic name may stand before the two flags, which are one digit.
    let named = rest.first().is_some_and(|word| !matches!(*word, "0" | "1"));
    let rest = if named { &rest[1..] } else { rest };
    let [_brs, _esi, _dlc, length, data @ ..] = rest else {
        bail!("need flags, data length code and length")
    };
    let length: usize = length.parse().ok().with_context(|| format!("length \"{length}\": need a number"))?;
    let bytes =
        data.get(..length).with_context(|| format!("{length} bytes announced, {} there", data.len()))?;
    let byte = |text: &&str| u8::from_str_radix(text, 16).ok().with_context(|| format!("data \"{text}\""));
    let bytes = bytes.iter().map(byte).collect::<Result<Vec<u8>>>()?;
    Ok(Some((channel - 1, CanFrame::new(id, &bytes)?)))
}

pub(crate) fn write(path: &Path, entries: &[LogEntry]) -> Result<Vec<String>> {
    let mut out = BufWriter::new(File::create(path)?);
    // The date has whole milliseconds; times count from there.
    let start_ms = entries.first().map_or(0, |entry| entry.timestamp_us / 1000);
    let start =
        Local.timestamp_millis_opt(i64::try_from(start_ms)?).single().context("time beyond all dates")?;
    let date = start.format("%a %b %d %H:%M:%S%.3f %Y");
    writeln!(out, "date {date}\nbase hex  timestamps absolute\ninternal events logged")?;
    writeln!(out, "Begin Triggerblock {date}\n 0.000000 Start of measurement")?;
    for entry in entries {
        let us =
            entry.timestamp_us.checked_sub(start_ms * 1000).context("a frame is before the first one")?;
        let data = entry.frame.data();
        let dlc = FD_LENGTHS.iter().position(|&length| usize::from(length) == data.len()).unwrap_or(0);
        write!(
            out,
            "{:>2}.{:06} CANFD {:>3} Rx   {:>8X}x  {:>32} 1 0 {dlc:x} {:>2}",
            us / 1_000_000,
            us % 1_000_000,
            channel(&entry.interface) + 1,
            entry.frame.id(),
            "",
            data.len()
        )?;
        for byte in data {
            write!(out, " {byte:02X}")?;
        }
        // Duration, length, flags (EDL and BRS), and what CANoe knows of the frame's bits: not known here.
        writeln!(out, " {:>8} {:>4} {:>8X} {:>8} {:>8} {:>8} {:>8} {:>8}", 0, 0, 0x3000, 0, 0, 0, 0, 0)?;
    }
    writeln!(out, "End TriggerBlock")?;
    out.flush()?;
    Ok(lost_names(entries))
}
