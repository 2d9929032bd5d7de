//! `slipsense convert`: recordings from one format to another.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use slipsense::wire::{NodeId, RawForm};
use slipsense_recording::Episode;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::label::StandLog;
use slipsense_recording::log_file::{self, Format, Record};
use slipsense_recording::rebuild::Rebuilder;

use super::Print;
use crate::bundled;
use crate::output::{check_file, write_file};
use crate::simulate::{simulate, stamp};
use crate::summary::counted;

/// Convert a recording: episode, candump, MCAP, and CSV for a test stand's crosshead
///
/// The ending of each name says the format. CAN frames keep their times to the microsecond. An episode becomes
/// the frames that a module would have sent, as `slipsense run` makes them; frames become an episode where their
/// raw messages came without a gap. What a conversion cannot carry is said.
#[derive(clap::Args)]
#[command(after_help = "\
Formats:
  .npz               episode of arrays and samples
  .log, .candump     candump log of can-utils
  .mcap              CAN frames and decoded messages with JSON schemas, for Foxglove and PlotJuggler
  .csv               time and travel of a test stand's crosshead (to .mcap, or from .npz and .mcap)

python-can makes Vector's ASC and BLF of a candump log, and the reverse:
  python -m can.logconvert can.log can.blf

Examples:
  slipsense convert can.log can.mcap
  slipsense convert grasp.npz grasp.log
  slipsense convert bus.mcap grasp.npz --xl-lsb-g 0.000133
  slipsense convert bus.log other.npz --node-id 43 --xl-lsb-g 0.000133 --json
  slipsense convert stand.csv stand.mcap")]
pub struct Args {
    /// Recording to read
    #[arg(value_name = "IN")]
    input: PathBuf,
    /// File to write
    #[arg(value_name = "OUT")]
    out: PathBuf,
    /// The module to rebuild an episode of, where several speak, 0 to 127
    #[arg(long, value_name = "N", value_parser = node_id)]
    node_id: Option<NodeId>,
    /// Acceleration of one count, g: an episode needs it, the bus does not carry it
    #[arg(long, value_name = "G")]
    xl_lsb_g: Option<f64>,
    #[command(flatten)]
    print: Print,
}

const XL_LSB_G_MISSING: &str = "--xl-lsb-g is missing: g per LSB, 0.000133 for an ADXL380, 0.0005 for an ADXL382, \
                                0.000122 for an ICM-42688-P";

pub fn node_id(text: &str) -> Result<NodeId, String> {
    text.parse().ok().and_then(NodeId::new).ok_or_else(|| "must be 0 to 127".to_owned())
}

enum Kind {
    Episode,
    Csv,
    Frames(Format),
}

fn kind(path: &Path) -> Result<Kind> {
    if let Some(format) = Format::from_path(path) {
        return Ok(Kind::Frames(format));
    }
    match path.extension().and_then(|ending| ending.to_str()) {
        Some("npz") => Ok(Kind::Episode),
        Some("csv") => Ok(Kind::Csv),
        _ => bail!("{}: must end in .npz, .log, .candump, .mcap or .csv", path.display()),
    }
}

impl Args {
    pub fn run(self) -> Result<()> {
        let (from, to) = (kind(&self.input)?, kind(&self.out)?);
        check_file(&self.out)?;
        let name = self.input.display();
        let mut frames = 0_u64;
        let (what, notes) = match to {
            Kind::Frames(format) => {
                let mut notes = Vec::new();
                let left_out = log_file::write(&self.out, format, |sink| {
                    notes = self.records(&from, |record| {
                        frames += u64::from(matches!(record, Record::Frame(_)));
                        sink.put(&record)
                    })?;
                    ensure!(
                        frames > 0 || format == Format::Mcap,
                        "{name}: no CAN frame in it; a crosshead's displacement goes to .mcap or .csv"
                    );
                    Ok(())
                })?;
                notes.extend(left_out);
                (format!("{frames} CAN frames"), notes)
            }
            Kind::Episode => self.rebuild(&from)?,
            Kind::Csv => {
                let mut displacement = Vec::new();
                let mut notes = self.records(&from, |record| {
                    match record {
                        Record::Displacement { timestamp_us, mm } => displacement.push((timestamp_us, mm)),
                        Record::Frame(_) => frames += 1,
                    }
                    Ok(())
                })?;
                ensure!(!displacement.is_empty(), "{name}: no crosshead's displacement in it");
                write_file(&self.out, csv(&displacement))?;
                if frames > 0 {
                    notes.push(format!("{frames} CAN frames are left out"));
                }
                (format!("{} positions", displacement.len()), notes)
            }
        };
        let out = self.out.display().to_string();
        self.print.show(&json!({"out": out, "wrote": what, "left_out": notes}), || {
            let notes: String = notes.iter().map(|note| format!("  {note}\n")).collect();
            format!("{what}: {out}\n{notes}")
        })
    }

    /// Hand over what is in the recording, entry by entry. Returns what is left out.
    fn records(&self, from: &Kind, mut put: impl FnMut(Record) -> Result<()>) -> Result<Vec<String>> {
        match from {
            Kind::Frames(format) => {
                let mut reader = log_file::open(&self.input, *format)?;
                reader.by_ref().try_for_each(|record| put(record?))?;
                Ok(reader.notes())
            }
            Kind::Episode => self.episode(put),
            Kind::Csv => self.stand(put),
        }
    }

    fn rebuild(&self, from: &Kind) -> Result<(String, Vec<String>)> {
        let lsb = self.xl_lsb_g.context(XL_LSB_G_MISSING)?;
        ensure!(lsb.is_finite() && lsb > 0.0, "--xl-lsb-g is {lsb}, must be above 0");
        let (mut rebuilder, mut displacement) = (Rebuilder::default(), false);
        let mut notes = self.records(from, |record| {
            match record {
                Record::Frame(entry) => rebuilder.accept(&entry),
                Record::Displacement { .. } => displacement = true,
            }
            Ok(())
        })?;
        let rebuilt =
            rebuilder.episode(self.node_id, lsb).with_context(|| self.input.display().to_string())?;
        rebuilt.episode.write(&self.out)?;
        if displacement {
            notes.push("the crosshead's displacement is left out: `slipsense label` adds it".to_owned());
        }
        notes.extend(rebuilt.notes);
        let (frames, sensors) = (rebuilt.episode.frames(), counted(rebuilt.episode.sensors, "sensor"));
        Ok((format!("{frames} frames of {sensors}"), notes))
    }

    fn episode(&self, mut put: impl FnMut(Record) -> Result<()>) -> Result<Vec<String>> {
        let episode = Episode::read(&self.input)?;
        let (frames, model) = (episode.frames(), bundled::model(None)?);
        self.print.progress(frames, "frames", |bar| {
            simulate(&episode, frames, model.parse()?, RawForm::Plain, |stamp, can| {
                bar.inc(1);
                let entry = |&frame: &_| {
                    let (timestamp_us, interface) = (stamp.timestamp_us, "can0".to_owned());
                    Record::Frame(LogEntry { timestamp_us, interface, frame })
                };
                can.iter().map(entry).try_for_each(&mut put)
            })
        })?;
        for (frame, &mm) in episode.displacement_mm.iter().flatten().enumerate() {
            put(Record::Displacement { timestamp_us: stamp(frame).timestamp_us, mm: f64::from(mm) })?;
        }
        let mut lost = vec!["what meta says of units and origin"];
        lost.extend(episode.label.is_some().then_some("labels"));
        lost.extend(episode.slip_true_mm_s.is_some().then_some("true slip speed"));
        lost.extend(episode.slip_fraction.is_some().then_some("slip fraction"));
        Ok(vec![format!("left out: {}", lost.join(", "))])
    }

    fn stand(&self, mut put: impl FnMut(Record) -> Result<()>) -> Result<Vec<String>> {
        let log = StandLog::read(&self.input)?;
        for (&time_s, &mm) in log.time_s.iter().zip(&log.travel_mm) {
            ensure!(time_s >= 0.0, "{}: time {time_s} s is below 0", self.input.display());
            put(Record::Displacement { timestamp_us: (time_s * 1e6).round() as u64, mm })?;
        }
        Ok(log.load_n.iter().map(|_| "the load is left out".to_owned()).collect())
    }
}

/// As `slipsense label --displacement` reads it.
fn csv(displacement: &[(u64, f64)]) -> String {
    let mut text = "Time [s],Travel [mm]\n".to_owned();
    for (us, mm) in displacement {
        let _ = writeln!(text, "{}.{:06},{mm}", us / 1_000_000, us % 1_000_000);
    }
    text
}
