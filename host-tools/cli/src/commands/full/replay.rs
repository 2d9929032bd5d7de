//! `slipsense replay`: a recording back to a bus.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::link::{Place, open_sink};
use slipsense_recording::log_file::{self, Format, Record};

use super::Print;
use super::live::DataRate;

/// Send a recording again: to a bus, a candump log or standard output
///
/// Frames go at the distances of the recording, or faster. To a log they keep their times.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense replay grasp.mcap socketcan:can0
  slipsense replay grasp.log slcan:/dev/ttyACM0 --speed 0.5
  slipsense replay grasp.log - | slipsense monitor - --plain
  slipsense replay grasp.mcap grasp.log --speed max")]
pub struct Args {
    /// Recording: .log, .candump or .mcap
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// Where to: socketcan:can0, slcan:/dev/ttyACM0, slcan:HOST:PORT, a candump log, or - for standard output
    #[arg(value_name = "TO")]
    to: Place,
    /// How fast: 1 is real time, `max` without waiting
    #[arg(long, value_name = "FACTOR", default_value = "1", value_parser = speed)]
    speed: f64,
    #[command(flatten)]
    data: DataRate,
    #[command(flatten)]
    print: Print,
}

/// Frames that are read before the first is sent, and kept ahead from then on: five seconds of three sensors, so that a
/// slow disk delays none, and what is shorter is checked as a whole beforehand.
const READ_AHEAD: usize = 100_000;
/// At which the times of every recording are within the range of a `Duration`.
const SLOWEST: f64 = 0.001;

fn speed(text: &str) -> Result<f64, String> {
    let factor = if text == "max" { Ok(f64::INFINITY) } else { text.parse() };
    let factor = factor.ok().filter(|&factor| factor >= SLOWEST);
    factor.ok_or_else(|| format!("must be {SLOWEST} or more, or max"))
}

impl Args {
    pub fn run(self) -> Result<()> {
        let Some(format) = Format::from_path(&self.input) else {
            bail!("{}: must end in .log, .candump or .mcap", self.input.display());
        };
        ensure!(
            !(self.print.json && self.to == Place::Standard),
            "--json: standard output is the bus already"
        );
        let mut recording = log_file::open(&self.input, format)?;
        let mut entries = recording.by_ref().filter_map(|record| match record {
            Ok(Record::Frame(entry)) => Some(Ok(entry)),
            Ok(Record::Displacement { .. }) => None,
            Err(error) => Some(Err(error)),
        });
        let mut ahead = entries.by_ref().take(READ_AHEAD).collect::<Result<VecDeque<_>>>()?;
        let first = ahead.front().with_context(|| format!("{}: no CAN frame in it", self.input.display()))?;
        let (mut late, mut frames, first_us) = (Duration::ZERO, 0, first.timestamp_us);
        let mut began = Instant::now();
        let mut play = |send: &mut dyn FnMut(LogEntry) -> Result<()>| -> Result<()> {
            began = Instant::now();
            while let Some(entry) = ahead.pop_front() {
                let after_us = entry.timestamp_us.saturating_sub(first_us);
                let due = Duration::from_secs_f64(after_us as f64 / 1e6 / self.speed);
                match due.checked_sub(began.elapsed()) {
                    Some(wait) if !wait.is_zero() => thread::sleep(wait),
                    _ => late = late.max(began.elapsed().saturating_sub(due)),
                }
                send(entry)?;
                frames += 1;
                ahead.extend(entries.next().transpose()?);
            }
            Ok(())
        };
        match &self.to {
            // Whole or not at all, and not before all of IN is read, which may be the same file. A pipe or a device is
            // no file that could be replaced.
            Place::File(path, Format::Candump) if path.is_file() || !path.exists() => {
                log_file::write(path, Format::Candump, |sink| {
                    play(&mut |entry| sink.put(&Record::Frame(entry)))
                })?;
            }
            to => {
                let mut sink = open_sink(to, self.data.data_mbit)?;
                play(&mut |entry| sink.send(&entry))?;
                sink.finish()?;
            }
        }
        let took_s = began.elapsed().as_secs_f64();
        let late_ms = if self.speed.is_finite() { late.as_secs_f64() * 1e3 } else { 0.0 };
        let notes = recording.notes();
        if self.to == Place::Standard {
            notes.iter().for_each(|note| eprintln!("note: {note}"));
            return Ok(());
        }
        let result = json!({"frames": frames, "took_s": took_s, "latest_ms": late_ms, "notes": notes});
        self.print.show(&result, || {
            let notes: String = notes.iter().map(|note| format!("  {note}\n")).collect();
            format!("{frames} frames in {took_s:.3} s, the latest {late_ms:.1} ms late\n{notes}")
        })
    }
}
