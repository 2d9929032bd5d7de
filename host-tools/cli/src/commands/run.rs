//! `slipsense demo` and `run`: the bundled episode, or any other, through the pipeline.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::ValueEnum;
use slipsense::wire::{Detail, RawForm};
use slipsense_recording::Episode;
use slipsense_recording::candump::CandumpWriter;

use super::{ModelArg, Print, written};
use crate::bundled::{self, NamedModel};
use crate::output::OutputDir;
use crate::simulate::simulate;
use crate::summary::Summary;
use crate::{picture, report};

/// Detect a slip in the bundled synthetic episode
///
/// A gripper with instrumented fingertips holds an object, the object is pulled and slips. The episode
/// is generated, its recipe is host-tools/cli/demo/recipe.json. It goes through the same code and the same
/// model as on a module, bit for bit.
#[derive(clap::Args)]
#[command(after_help = "\
Writes timeline.svg, report.html, can.log, predictions.npz and summary.json; `slipsense run --help`
says what each holds.

Examples:
  slipsense demo
  slipsense demo --out /tmp/demo --json")]
pub struct DemoArgs {
    /// Folder to write; made if it does not exist
    #[arg(long, value_name = "DIR", default_value = "out/demo")]
    out: PathBuf,
    #[command(flatten)]
    print: Print,
}

impl DemoArgs {
    pub fn run(self) -> Result<()> {
        let out = OutputDir::prepare(&self.out)?;
        let (episode, model) = (bundled::episode()?, bundled::model(None)?);
        run((&episode, bundled::NAME), &model, Raw::Plain, &self.out, out, &self.print)
    }
}

/// Run an episode file: slip flags, picture, report and CAN log
///
/// Runs the firmware's signal path over every frame of an episode and writes the results. Where the
/// episode has labels, each slip event is matched with the first flag between 50 ms before its onset
/// and its end; without labels there are no delays. Slip may begin where the class is slip; the slip flag
/// is the one at the model's operating point (see `slipsense tune`).
#[derive(clap::Args)]
#[command(after_help = "\
Files written to the output folder:
  timeline.svg     pressure, log-mel, logits, slip flag and truth over time
  report.html      the same with a table and explanations, one file to share
  can.log          the CAN FD traffic as a candump log: slip message first, then the raw frames
  predictions.npz  class, logits, log_odds, may_begin, slip, logmel, logmel_std per frame, for numpy.load
  summary.json     events, delays, false alarms of may begin and of slip, scores, speed

Examples:
  slipsense run grasp.npz --out out/grasp
  slipsense run grasp.npz --out out/other --model other.slipnet
  slipsense run grasp.npz --out out/short --raw compressed
  slipsense run grasp.npz --out out/grasp --json | jq '.truth.events[].delay_ms'")]
pub struct Args {
    /// Episode to run, an .npz file
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// Folder to write; made if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    model: ModelArg,
    /// Form of the raw frames in can.log
    #[arg(long, value_enum, default_value_t = Raw::Plain)]
    raw: Raw,
    #[command(flatten)]
    print: Print,
}

/// The two raw messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Raw {
    /// slipsense.Raw: any Cyphal client reads it by its definition
    Plain,
    /// slipsense.RawCompressed: the same, shorter, without loss
    Compressed,
}

impl Raw {
    pub const fn form(self) -> RawForm {
        match self {
            Self::Plain => RawForm::Plain,
            Self::Compressed => RawForm::Compressed(Detail::All),
        }
    }
}

impl Args {
    pub fn run(self) -> Result<()> {
        let model = self.model.read()?;
        model.parse()?;
        let out = OutputDir::prepare(&self.out)?;
        let (episode, name) = (Episode::read(&self.episode)?, self.episode.display().to_string());
        run((&episode, &name), &model, self.raw, &self.out, out, &self.print)
    }
}

/// Run an episode and write the results of it, which `name` stands for.
pub fn run(
    (episode, name): (&Episode, &str),
    file: &NamedModel,
    raw: Raw,
    folder: &Path,
    out: OutputDir,
    printer: &Print,
) -> Result<()> {
    let model = file.parse()?;
    let cannot = "can.log: cannot write";
    let mut log = CandumpWriter::new(File::create(out.path("can.log")).context(cannot)?, "can0")?;
    let frames = episode.frames();
    let simulation = printer.progress(frames, "frames", |bar| {
        simulate(episode, frames, model, raw.form(), |stamp, can| {
            bar.inc(1);
            can.iter().try_for_each(|frame| log.write(stamp.timestamp_us, frame)).context(cannot)
        })
    })?;
    log.finish().context(cannot)?;
    let summary = Summary::new(episode, name, &model, &file.name, &simulation);
    simulation.predictions.write(out.path("predictions.npz"))?;
    let timeline = picture::timeline(episode, &simulation, &summary)?;
    out.write("timeline.svg", &timeline)?;
    out.write("report.html", report::html(&summary, &timeline))?;
    out.write("summary.json", serde_json::to_string_pretty(&summary)? + "\n")?;
    out.commit()?;
    let files = [
        ("report", "report.html"),
        ("picture", "timeline.svg"),
        ("CAN log", "can.log"),
        ("predictions", "predictions.npz"),
        ("numbers", "summary.json"),
    ];
    printer.show(&summary, || format!("{summary}\n{}", written(folder, &files)))
}
