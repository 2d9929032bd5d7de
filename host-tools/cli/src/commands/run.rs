//! `slipsense run`: any episode file through the pipeline, and what both it and the demo write.

use std::fs::File;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::{Args as ClapArgs, ValueEnum};
use slipsense::net::Model;
use slipsense::wire::{Detail, RawForm};
use slipsense_recording::Episode;
use slipsense_recording::candump::CandumpWriter;

use crate::output_dir::OutputDir;
use crate::simulate::{Simulation, simulate};
use crate::summary::Summary;
use crate::{bundled, picture, report};

/// Run an episode file: slip flags, picture, report and CAN log
///
/// Runs the firmware's signal path over every frame of an episode and writes what came out. Where the
/// episode has labels, each slip event is matched with the first flag between 50 ms before its onset
/// and its end; without labels there are no delays. The alarm is the flag at the model's operating point
/// (see `slipsense tune`), the slip flag what its classes say frame by frame.
#[derive(ClapArgs)]
#[command(after_help = "\
Files written to the output folder:
  timeline.svg     pressure, log-mel, logits, slip flag and truth over time
  report.html      the same with a table and explanations, one file to share
  can.log          the CAN FD traffic as a candump log: slip message first, then the raw frames
  predictions.npz  class, logits, slip, alarm, logmel, logmel_std per frame, for numpy.load
  summary.json     events, delays, false alarms, the same of the alarm, scores, speed

Examples:
  slipsense run grasp.npz --out out/grasp
  slipsense run grasp.npz --out out/other --model other.slipnet
  slipsense run grasp.npz --out out/short --raw compressed
  slipsense run grasp.npz --out out/grasp --json | jq '.truth.events[].delay_ms'")]
pub struct Args {
    /// Episode to run, an .npz file
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// Folder to write; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Model file; the bundled one if not given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// How the raw frames stand in can.log
    #[arg(long, value_enum, default_value_t = Raw::Plain)]
    raw: Raw,
    /// Print summary.json to standard output, nothing else
    #[arg(long)]
    json: bool,
}

/// The two raw messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Raw {
    /// slipsense.Raw: any Cyphal client reads it by its definition
    Plain,
    /// slipsense.RawCompressed: the same, shorter, without loss
    Compressed,
}

impl Raw {
    /// As the option names it.
    pub(crate) const fn word(self) -> &'static str {
        match self {
            Self::Plain => "plain",
            Self::Compressed => "compressed",
        }
    }

    /// As the transmitter makes it.
    pub(crate) const fn form(self) -> RawForm {
        match self {
            Self::Plain => RawForm::Plain,
            Self::Compressed => RawForm::Compressed(Detail::All),
        }
    }
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        let (bytes, model_name) = bundled::model_or(self.model.as_deref())?;
        let model = Model::parse(&bytes).with_context(|| format!("model {model_name}"))?;
        let out = OutputDir::prepare(&self.out)?;
        let episode = Episode::read(&self.episode)?;
        let name = self.episode.display().to_string();
        process(&Job { episode, name, model, model_name, raw: self.raw, json: self.json }, out, &self.out)
    }
}

/// One episode to run, and by which model.
pub(crate) struct Job<'m> {
    pub(crate) episode: Episode,
    /// Stands for the episode's file.
    pub(crate) name: String,
    pub(crate) model: Model<'m>,
    /// Stands for the model's file.
    pub(crate) model_name: String,
    pub(crate) raw: Raw,
    pub(crate) json: bool,
}

/// Run a job, write all files, print the result.
pub(crate) fn process(job: &Job<'_>, out: OutputDir, folder: &Path) -> Result<()> {
    let simulation = run_to_log(job, &out)?;
    let summary = Summary::new(&job.episode, &job.name, &job.model, &job.model_name, &simulation);
    simulation.predictions.write(out.path("predictions.npz"))?;
    let timeline = picture::timeline(&job.episode, &simulation, &summary)?;
    out.write("timeline.svg", &timeline)?;
    out.write("report.html", report::html(&summary, &timeline))?;
    out.write("summary.json", serde_json::to_string_pretty(&summary)? + "\n")?;
    out.commit()?;
    if job.json {
        return super::print_json(&summary);
    }
    let at = |name: &str| folder.join(name).display().to_string();
    super::print(&format!(
        "{summary}\n  report        {}\n  picture       {}\n  CAN log       {}\n  numbers       {}, {}\n",
        at("report.html"),
        at("timeline.svg"),
        at("can.log"),
        at("predictions.npz"),
        at("summary.json"),
    ))
}

fn run_to_log(job: &Job<'_>, out: &OutputDir) -> Result<Simulation> {
    let path = out.path("can.log");
    let file = File::create(&path).context("can.log: cannot write")?;
    let mut log = CandumpWriter::new(file, "can0")?;
    let progress = super::progress(job.episode.frames(), "frames", job.json);
    let simulation = simulate(
        &job.episode,
        job.model,
        job.raw.form(),
        |timestamp_us, frame| log.write(timestamp_us, frame).context("can.log: cannot write"),
        || progress.inc(1),
    )?;
    log.finish().context("can.log: cannot write")?;
    progress.finish_and_clear();
    Ok(simulation)
}
