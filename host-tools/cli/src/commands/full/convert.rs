//! `slipsense convert`: recordings from one format to another.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::json;
use slipsense::wire::{NodeId, RawForm};
use slipsense_recording::Episode;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::label::StandLog;
use slipsense_recording::log_file::{self, Format, Recording};
use slipsense_recording::rebuild;

use super::Print;
use crate::output::{check_file, write_file};
use crate::simulate::{simulate, stamp};
use crate::{bundled, summary};

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
  slipsense convert bus.mcap grasp.npz --xl-lsb-g 0.000488
  slipsense convert bus.log other.npz --node-id 43 --xl-lsb-g 0.000488 --json
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
        let recording = match from {
            Kind::Frames(format) => log_file::read(&self.input, format)?,
            Kind::Episode => self.read_episode()?,
            Kind::Csv => self.read_stand()?,
        };
        let mut notes = recording.notes.clone();
        let name = self.input.display();
        let what = match to {
            Kind::Frames(format) => {
                let carries = !recording.entries.is_empty() || format == Format::Mcap;
                ensure!(
                    carries,
                    "{name}: no CAN frame in it; a crosshead's displacement goes to .mcap or .csv"
                );
                notes.extend(log_file::write(&self.out, format, &recording)?);
                format!("{} CAN frames", recording.entries.len())
            }
            Kind::Episode => {
                let lsb = self
                    .xl_lsb_g
                    .context("--xl-lsb-g is missing: an episode needs it (0.000488 at ±16 g)")?;
                ensure!(lsb.is_finite() && lsb > 0.0, "--xl-lsb-g is {lsb}, must be above 0");
                let rebuilt = rebuild::episode(&recording.entries, self.node_id, lsb)
                    .with_context(|| name.to_string())?;
                rebuilt.episode.write(&self.out)?;
                if !recording.displacement.is_empty() {
                    notes.push(
                        "the crosshead's displacement is left out: `slipsense label` adds it".to_owned(),
                    );
                }
                notes.extend(rebuilt.notes);
                let (frames, sensors) = (rebuilt.episode.frames(), rebuilt.episode.sensors);
                format!("{frames} frames of {sensors} sensor{}", summary::plural(sensors))
            }
            Kind::Csv => {
                ensure!(!recording.displacement.is_empty(), "{name}: no crosshead's displacement in it");
                write_file(&self.out, csv(&recording.displacement))?;
                if !recording.entries.is_empty() {
                    notes.push(format!("{} CAN frames are left out", recording.entries.len()));
                }
                format!("{} positions", recording.displacement.len())
            }
        };
        let out = self.out.display().to_string();
        self.print.show(&json!({"out": out, "wrote": what, "left_out": notes}), || {
            let notes: String = notes.iter().map(|note| format!("  {note}\n")).collect();
            format!("{what}: {out}\n{notes}")
        })
    }

    fn read_episode(&self) -> Result<Recording> {
        let episode = Episode::read(&self.input)?;
        let mut entries = Vec::new();
        let progress = self.print.progress(episode.frames(), "frames");
        simulate(
            &episode,
            bundled::model(None)?.parse()?,
            RawForm::Plain,
            |timestamp_us, &frame| {
                entries.push(LogEntry { timestamp_us, interface: "can0".to_owned(), frame });
                Ok(())
            },
            || progress.inc(1),
        )?;
        progress.finish_and_clear();
        let displacement = episode.displacement_mm.iter().flatten().enumerate();
        let displacement = displacement.map(|(f, &mm)| (stamp(f).timestamp_us, f64::from(mm))).collect();
        let mut lost = vec!["what meta says of units and origin"];
        lost.extend(episode.label.is_some().then_some("labels"));
        lost.extend(episode.slip_true_mm_s.is_some().then_some("true slip speed"));
        lost.extend(episode.slip_fraction.is_some().then_some("slip fraction"));
        let notes = vec![format!("left out: {}", lost.join(", "))];
        Ok(Recording { entries, displacement, notes })
    }

    fn read_stand(&self) -> Result<Recording> {
        let log = StandLog::read(&self.input)?;
        let mut displacement = Vec::new();
        for (&time_s, &mm) in log.time_s.iter().zip(&log.travel_mm) {
            ensure!(time_s >= 0.0, "{}: time {time_s} s is below 0", self.input.display());
            displacement.push(((time_s * 1e6).round() as u64, mm));
        }
        let notes = log.load_n.iter().map(|_| "the load is left out".to_owned()).collect();
        Ok(Recording { entries: Vec::new(), displacement, notes })
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
