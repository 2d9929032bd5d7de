//! `slipsense label`: recordings into labelled episodes.

use std::fmt::Write;
use std::ops::Range;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use clap::ArgGroup;
use serde_json::{Value, json};
use slipsense_recording::Episode;
use slipsense_recording::label::{
    AtFrames, Intervals, NO_CONTACT, Pull, SLIP, StandLog, align, label, logged_knocks, pulls,
    recorded_knocks, slip_without_contact,
};
use slipsense_recording::score::{CLASSES, Interval, runs};

use super::Print;
use crate::output::check_file;
use crate::picture::CLASS_NAME;
use crate::summary::{count_classes, counted, file_name, seconds};

/// Label a recording: which frames are slip, from a test stand's log or by hand
///
/// Contact is what the pads say, as everywhere. Slip is where the crosshead of a test stand pulls what the
/// gripper holds, by the paper's rule: from more than 0.07 mm after the start of a pull, until less than
/// 0.07 mm remains. That holds for an object that is clamped to the crosshead and does not stretch. Where
/// nothing can slip (not clamped, or gripped so firmly that gripper and object move together) say --no-slip,
/// or name the pulls that do with --only.
#[derive(clap::Args)]
#[command(group = ArgGroup::new("source").args(["displacement", "manual", "no_slip"]).required(true))]
#[command(group = ArgGroup::new("clock").args(["offset_s", "knocks"]))]
#[command(after_help = "\
The stand's log is a table with columns for time and travel, and for --knocks one for load, such as
Mark-10's \"Reading,Load [N],Travel [mm],Time [sec]\". Lines before the table, semicolons, tabs, decimal
commas and other units are understood.

Its clock is not the recording's. Say what it showed when the recording began (--offset-s), or knock
twice on the clamp, about a second apart, in the first five seconds and before the crosshead moves, so
that both accelerometer and load cell feel it (--knocks). An offset that is not clear is refused.

Examples:
  slipsense label r01.npz --displacement r01.csv --knocks --pulls           look first, write nothing
  slipsense label r01.npz --displacement r01.csv --knocks --object my-mug --out data/r01.npz
  slipsense label r02.npz --displacement r02.csv --offset-s 3.2 --only 2,4 --object my-mug --out data/r02.npz
  slipsense label r03.npz --manual 3.20:4.75,8:9.5 --object tape --out data/r03.npz
  slipsense label idle.npz --no-slip --object none --out data/idle.npz
  cargo run --release --features train -- train --data data --out out/train")]
pub struct Args {
    /// Recording, an .npz file; labels that it has are replaced
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// The test stand's log of the same minutes
    #[arg(long, value_name = "FILE.csv", requires = "clock")]
    displacement: Option<PathBuf>,
    /// What the stand's clock showed when the recording began, seconds
    #[arg(long, value_name = "S", allow_negative_numbers = true, requires = "displacement")]
    offset_s: Option<f64>,
    /// Find that from two knocks in the first seconds (5 if no number is given) of recording and log
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, require_equals = true)]
    #[arg(default_missing_value = "5", requires = "displacement")]
    knocks: Option<f64>,
    /// Slip intervals by hand, seconds from the start of the recording
    #[arg(long, value_name = "START:END,…", value_parser = str::parse::<Intervals>)]
    manual: Option<Intervals>,
    /// Nothing slips in this recording
    #[arg(long)]
    no_slip: bool,
    /// Only these pulls slip, by their number in the list that --pulls prints
    #[arg(long, value_name = "N,…", value_delimiter = ',', requires = "displacement")]
    only: Option<Vec<usize>>,
    /// Print the crosshead's pulls for a person to check, and write nothing
    #[arg(long, requires = "displacement")]
    pulls: bool,
    /// Name of the object; training splits by it. The recording's own if it has one
    #[arg(long, value_name = "NAME")]
    object: Option<String>,
    /// Name of the sensor unit, once for each sensor in order
    #[arg(long, value_name = "ID")]
    unit: Vec<String>,
    /// Name of the hand
    #[arg(long, value_name = "NAME")]
    platform: Option<String>,
    /// Labelled episode to write
    #[arg(long, value_name = "FILE.npz", required_unless_present = "pulls")]
    out: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

/// The log at the recording's frames, and how it got there.
struct Stand {
    log: StandLog,
    file: String,
    offset_s: f64,
    /// Knocks that agree, and the confidence in them; nothing where the offset was given.
    knocks: Option<(usize, f64)>,
    at: AtFrames,
    pulls: Vec<Pull>,
}

impl Args {
    pub fn run(self) -> Result<()> {
        if let Some(out) = self.out.as_ref().filter(|_| !self.pulls) {
            check_file(out)?;
        }
        let mut episode = Episode::read(&self.episode)?;
        let stand = self.displacement.as_ref().map(|path| self.stand(path, &episode)).transpose()?;
        if let Some(stand) = stand.as_ref().filter(|_| self.pulls) {
            return self.report_pulls(&episode, stand);
        }
        let slips = self.slips(&episode, stand.as_ref())?;
        self.describe(&mut episode, stand.as_ref()).with_context(|| self.episode.display().to_string())?;
        let labels = label(&episode.piezo, episode.sensors, &slips);
        let without_contact = slip_without_contact(&labels, &slips);
        episode.meta.other.insert("slip_frames_without_contact".to_owned(), without_contact.into());
        let facts = Facts {
            class_frames: count_classes(&labels),
            slips: runs(labels.len(), |frame| labels[frame] == SLIP),
            slip_frames_without_contact: without_contact,
        };
        episode.label = Some(labels);
        if let Some(stand) = &stand {
            episode.displacement_mm = Some(stand.at.displacement_mm.clone());
        }
        let out = self.out.as_ref().context("--out is missing")?;
        episode.write(out)?;
        let (label, object) = (&episode.meta.other["label"], &episode.meta.other["object"]);
        let out = out.display().to_string();
        let result = json!({"out": out, "object": object, "label": label, "result": facts});
        self.print.show(&result, || self.table(&episode, stand.as_ref(), &facts, &out))
    }

    /// Read the log and bring it to the recording's frames.
    fn stand(&self, path: &Path, episode: &Episode) -> Result<Stand> {
        let log = StandLog::read(path)?;
        let in_file = || path.display().to_string();
        let (offset_s, knocks) = match (self.offset_s, self.knocks) {
            (Some(offset_s), _) => {
                ensure!(offset_s.is_finite(), "--offset-s is {offset_s}, must be a number of seconds");
                (offset_s, None)
            }
            (None, Some(within_s)) => {
                ensure!(within_s > 0.0, "--knocks is {within_s}, must be above 0 seconds");
                let logged = logged_knocks(&log, within_s).with_context(in_file)?;
                let found = align(&recorded_knocks(episode, within_s), &logged, 1.0 / log.rate_hz());
                let found = found.with_context(in_file)?;
                (found.offset_s, Some((found.matched, found.confidence)))
            }
            (None, None) => bail!("--displacement needs --offset-s or --knocks"),
        };
        let at = log.at_frames(episode.frames(), offset_s).with_context(in_file)?;
        let (pulls, file) = (pulls(&at.displacement_mm), file_name(path));
        Ok(Stand { log, file, offset_s, knocks, at, pulls })
    }

    /// Frames in which something slips, wherever there is contact.
    fn slips(&self, episode: &Episode, stand: Option<&Stand>) -> Result<Vec<Range<usize>>> {
        if let Some(manual) = &self.manual {
            return manual.frames(episode.frames()).context("--manual");
        }
        let pulls = stand.map_or(&[][..], |stand| &stand.pulls);
        let Some(only) = &self.only else { return Ok(pulls.iter().map(|pull| pull.slip.clone()).collect()) };
        let one = |&number: &usize| {
            let pull = number.checked_sub(1).and_then(|index| pulls.get(index));
            let count = pulls.len();
            pull.map(|pull| pull.slip.clone()).with_context(|| {
                format!("--only: there is no pull {number}, the log has {count} (see --pulls)")
            })
        };
        only.iter().map(one).collect()
    }

    /// Write into the metadata what the recording is and where its labels come from.
    fn describe(&self, episode: &mut Episode, stand: Option<&Stand>) -> Result<()> {
        let sensors = episode.sensors;
        let meta = &mut episode.meta.other;
        if let Some(object) = &self.object {
            ensure!(!object.trim().is_empty(), "--object must be a name");
            meta.insert("object".to_owned(), object.trim().into());
        }
        ensure!(
            meta.get("object").is_some_and(Value::is_string),
            "has no \"object\" in its meta: say --object NAME, training splits by it"
        );
        if !self.unit.is_empty() {
            let count = self.unit.len();
            ensure!(
                count == sensors,
                "--unit is given {count} times, must be once for each of {sensors} sensors"
            );
            meta.insert("units".to_owned(), json!(self.unit));
        }
        if let Some(platform) = &self.platform {
            meta.insert("platform".to_owned(), json!(platform));
        }
        let (rule, source) = match stand {
            Some(stand) => ("encoder", stand.json(self.only.as_deref())),
            None if self.no_slip => ("no_slip", json!({"source": "nothing slips, says a person"})),
            None => ("manual", json!({"source": "intervals by hand"})),
        };
        meta.insert("label_rule".to_owned(), rule.into());
        meta.insert("label".to_owned(), source);
        Ok(())
    }

    fn report_pulls(&self, episode: &Episode, stand: &Stand) -> Result<()> {
        let touched = label(&episode.piezo, episode.sensors, &[]);
        let contact = |pull: &Pull| touched[pull.slip.clone()].iter().filter(|&&l| l != NO_CONTACT).count();
        let rows: Vec<(&Pull, usize)> = stand.pulls.iter().map(|pull| (pull, contact(pull))).collect();
        let json = rows.iter().enumerate().map(|(index, (pull, contact))| {
            json!({
                "pull": index + 1, "onset_frame": pull.slip.start, "end_frame": pull.slip.end,
                "onset_s": seconds(pull.slip.start), "end_s": seconds(pull.slip.end),
                "from_mm": pull.from_mm, "to_mm": pull.to_mm, "cut": pull.cut,
                "frames_with_contact": contact,
            })
        });
        let json = json!({"label": stand.json(None), "pulls": json.collect::<Vec<_>>()});
        self.print.show(&json, || {
            let mut text = format!("{}\n\n", stand.words());
            text += "   pull     onset        end      from mm     to mm   with contact\n";
            for (index, (Pull { slip, from_mm, to_mm, cut }, contact)) in rows.iter().enumerate() {
                let share = 100.0 * *contact as f64 / slip.len() as f64;
                let (onset_s, end_s) = (seconds(slip.start), seconds(slip.end));
                let note = if *cut { "   cut by the recording's end" } else { "" };
                let _ = writeln!(
                    text,
                    "  {:>5} {onset_s:>9.3} s {end_s:>9.3} s {from_mm:>10.2} {to_mm:>9.2} {share:>12.0} %{note}",
                    index + 1
                );
            }
            if rows.is_empty() {
                text += "   none\n";
            }
            text + "\nEvery pull with contact is slip; --only 1,3 chooses some of them. Nothing was written.\n"
        })
    }

    fn table(&self, episode: &Episode, stand: Option<&Stand>, facts: &Facts, out: &str) -> String {
        let meta = &episode.meta.other;
        let (frames, sensors) = (episode.frames(), counted(episode.sensors, "sensor"));
        let object = meta["object"].as_str().unwrap_or_default();
        let kind = if meta.get("synthetic") == Some(&Value::Bool(true)) { ", synthetic" } else { "" };
        let name = file_name(&self.episode);
        let mut text = format!("{name}, {object}{kind}, {sensors}, {:.2} s\n", seconds(frames));
        text += &stand.map_or_else(
            || format!("labels: {}", meta["label"]["source"].as_str().unwrap_or("")),
            Stand::words,
        );
        text += "\n\n  class         frames    share\n";
        for (name, count) in CLASS_NAME.iter().zip(facts.class_frames) {
            let _ = writeln!(text, "  {name:<10} {count:>9} {:>7.1} %", 100.0 * count as f64 / frames as f64);
        }
        text += "\n   slip     onset        end\n";
        for (index, (onset, end)) in facts.slips.iter().enumerate() {
            let _ = writeln!(text, "  {:>5} {:>9.3} s {:>9.3} s", index + 1, seconds(*onset), seconds(*end));
        }
        if facts.slips.is_empty() {
            text += "   none\n";
        }
        let outside = facts.slip_frames_without_contact;
        if outside > 0 {
            let _ =
                writeln!(text, "\n  {outside} frames of pulls or intervals have no contact and are no slip");
        }
        text + &format!("\n  written  {out}\n")
    }
}

impl Stand {
    fn json(&self, only: Option<&[usize]>) -> Value {
        json!({
            "source": "crosshead travel of a test stand",
            "file": self.file,
            "readings_hz": self.log.rate_hz(),
            "offset_s": self.offset_s,
            "offset_from": if self.knocks.is_some() { "knocks" } else { "given" },
            "knocks": self.knocks.map(|(matched, _)| matched),
            "confidence": self.knocks.map(|(_, confidence)| confidence),
            "held_frames": self.at.held_frames,
            "pulls": self.pulls.len(),
            "only": only,
        })
    }

    fn words(&self) -> String {
        let Self { file, offset_s, .. } = self;
        let (columns, rate_hz) = (self.log.columns.join(", "), self.log.rate_hz());
        let known_ms = 500.0 / rate_hz;
        let mut text = format!(
            "labels: {file} ({columns}; {rate_hz:.0} readings/s: an onset is known to ±{known_ms:.0} ms)\n\
             clock:  offset {offset_s:.3} s"
        );
        text += &match self.knocks {
            None => ", given".to_owned(),
            Some((matched, confidence)) => format!(
                " from {matched} knocks, confidence {confidence:.2} (0: ambiguous, two clear knocks: 0.50)"
            ),
        };
        let unitless = self.log.without_unit.join(", ");
        if !unitless.is_empty() {
            let _ = write!(text, "\nunits:  none for {unitless}: taken as s, mm, N");
        }
        let held = self.at.held_frames;
        if held > 0 {
            let _ = write!(text, "\nedges:  {held} frames lie outside the log, its nearest position is held");
        }
        text
    }
}

#[derive(serde::Serialize)]
struct Facts {
    /// No contact, no slip, slip.
    class_frames: [u64; CLASSES],
    /// First frame of each slip, and the frame after its last.
    slips: Vec<Interval>,
    slip_frames_without_contact: usize,
}
