//! `slipsense view`: what the sensors feel, on a page of this computer.

use std::fs::File;
use std::io::{BufRead, BufReader, stdin};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::view::server::PageServer;
use crate::view::store::{Session, Store};
use crate::view::{bus, episode, record};
use anyhow::{Context, Result, bail};
use clap::Args as ClapArgs;
use slipsense::net::Model;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::wire::NodeId;
use slipsense_recording::Episode;

use crate::bundled;
use crate::summary::EpisodeFacts;

/// Where a command line means standard input.
const STANDARD_INPUT: &str = "-";

/// Show an episode, a CAN log or a live bus on a page of this computer
///
/// Pressure maps, log-mel, logits, slip flag, alarm and health of up to three sensors, with the truth where an
/// episode has labels. Opens nothing to the network: the page is served to this computer only, and works without
/// internet. An episode goes through the pipeline here; of a log or a bus the module's own decisions are shown, and
/// its samples become log-mel here.
#[derive(ClapArgs)]
#[command(after_help = "\
On the page: space plays and pauses, the arrows step a frame (with shift a second), n and p go to the next and
previous slip, home and end to the ends; the strip at the bottom is the whole recording, click it.

Examples:
  slipsense view                                  the bundled synthetic episode
  slipsense view grasp.npz --port 8421
  slipsense view out/demo/can.log                 a candump log
  candump -L can0 | slipsense view - --node 42    a live bus
  slipsense view - < can.log                      a log as if it were live

Ends with Ctrl-C.")]
pub struct Args {
    /// An episode (.npz), a candump log, or - for a candump log on standard input, which may be a live bus; the
    /// bundled episode if not given
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// Port of this computer to serve the page on; 0 takes any that is free
    #[arg(long, value_name = "PORT", default_value_t = 8420)]
    port: u16,
    /// Address of the module on the bus, for logs
    #[arg(long, value_name = "ID", default_value_t = NodeId::DEFAULT.get(), value_parser = clap::value_parser!(u8).range(0..=127))]
    node: u8,
    /// Model file, for episodes; the bundled one if not given
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Keep the last so many seconds; what is older is forgotten. A second of three sensors takes 1.5 MB
    #[arg(long, value_name = "S", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=3600))]
    keep_s: u32,
}

/// Where frames come from.
enum Source {
    Episode(Box<Episode>, Vec<u8>),
    Log(Box<dyn BufRead + Send>),
}

impl Args {
    pub(crate) fn run(self) -> Result<()> {
        let node = NodeId::new(self.node).context("--node: at most 127")?;
        let (name, source, live) = self.source()?;
        let (sensors, synthetic) = match &source {
            Source::Episode(episode, _) => {
                (episode.sensors, Some(EpisodeFacts::new(episode, &name).synthetic))
            }
            // How many a module has, its first message says.
            Source::Log(_) => (MAX_SENSORS, None),
        };
        let session = Session {
            id: SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_millis() as u64),
            name,
            synthetic,
            sensors,
            record_bytes: record::bytes(sensors),
            frame_rate_hz: FRAME_RATE_HZ,
            live,
        };
        let server = PageServer::bind(self.port)?;
        let store = Arc::new(Store::new(session, self.keep_s as usize * FRAME_RATE_HZ as usize));
        let filled = Arc::clone(&store);
        thread::spawn(move || {
            let problem = match source {
                Source::Episode(episode, model) => Model::parse(&model)
                    .map_err(anyhow::Error::from)
                    .and_then(|model| Ok(episode::run(&episode, model, &filled)?)),
                Source::Log(log) => bus::run(log, node, &filled).map_err(anyhow::Error::from),
            };
            if let Err(problem) = &problem {
                eprintln!("error: {problem:#}");
            }
            filled.end(problem.err().map(|problem| format!("{problem:#}")));
        });
        super::print(&format!("{}\n", server.url()))?;
        server.serve(&store);
        Ok(())
    }

    /// Name, frames, and whether they come by themselves.
    fn source(&self) -> Result<(String, Source, bool)> {
        let (model, model_name) = bundled::model_or(self.model.as_deref())?;
        Model::parse(&model).with_context(|| format!("model {model_name}"))?;
        let Some(path) = &self.file else {
            let episode = Episode::from_bytes(bundled::EPISODE, bundled::NAME)?;
            return Ok(("bundled episode".to_owned(), Source::Episode(Box::new(episode), model), false));
        };
        if path == Path::new(STANDARD_INPUT) {
            self.refuse_model()?;
            let log = Box::new(BufReader::new(stdin()));
            return Ok(("standard input".to_owned(), Source::Log(log), true));
        }
        let name =
            path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
        if path.extension().is_some_and(|extension| extension == "npz") {
            return Ok((name, Source::Episode(Box::new(Episode::read(path)?), model), false));
        }
        self.refuse_model()?;
        let file = File::open(path).with_context(|| format!("{}: cannot read the log", path.display()))?;
        Ok((name, Source::Log(Box::new(BufReader::new(file))), false))
    }

    fn refuse_model(&self) -> Result<()> {
        if self.model.is_some() {
            bail!("--model: a log holds the module's own decisions; a model is for episodes");
        }
        Ok(())
    }
}
