//! `slipsense view`: a recording or a live bus on a page of this computer.

use std::fs::File;
use std::io::{BufRead, BufReader, stdin};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};
use slipsense::wire::NodeId;
use slipsense_recording::Episode;

use super::convert::node_id;
use super::{ModelArg, print};
use crate::bundled::{self, NamedModel};
use crate::summary::EpisodeInfo;
use crate::view::server::PageServer;
use crate::view::store::{Session, Store};
use crate::view::{record, source};

const STANDARD_INPUT: &str = "-";

/// Show an episode, a CAN log or a live bus on a page of this computer
///
/// Pressure maps, log-mel, logits, flags and health of up to three sensors, with the truth where an
/// episode has labels. Opens nothing to the network: the page is served to this computer only, and works without
/// internet. An episode goes through the pipeline here; of a log or a bus the module's own decisions are shown, and
/// its samples become log-mel here.
#[derive(clap::Args)]
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
    #[arg(long, value_name = "ID", default_value = "42", value_parser = node_id)]
    node: NodeId,
    #[command(flatten)]
    model: ModelArg,
    /// Keep this many seconds; older frames are dropped. A second of three sensors takes 1.5 MB
    #[arg(long, value_name = "S", default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=3600))]
    keep_s: u32,
}

enum Source {
    Episode(Box<Episode>, NamedModel),
    Log(Box<dyn BufRead + Send>),
}

impl Args {
    pub fn run(self) -> Result<()> {
        let (name, source, live) = self.source()?;
        let (sensors, synthetic) = match &source {
            Source::Episode(episode, _) => {
                (episode.sensors, Some(EpisodeInfo::new(episode, &name).synthetic))
            }
            // The number of sensors is in the module's first message.
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
        let (filled, node) = (Arc::clone(&store), self.node);
        thread::spawn(move || {
            let done = match source {
                Source::Episode(episode, model) => {
                    model.parse().and_then(|model| Ok(source::run_episode(&episode, model, &filled)?))
                }
                Source::Log(log) => source::run_log(log, node, &filled).map_err(anyhow::Error::from),
            };
            let problem = done.err().map(|error| format!("{error:#}"));
            problem.iter().for_each(|problem| eprintln!("error: {problem}"));
            filled.end(problem);
        });
        print(&format!("{}\n", server.url()))?;
        server.serve(&store);
        Ok(())
    }

    /// Name, source, and whether its frames come in real time.
    fn source(&self) -> Result<(String, Source, bool)> {
        let model = self.model.read()?;
        model.parse()?;
        let Some(path) = &self.file else {
            let episode = Box::new(bundled::episode()?);
            return Ok(("bundled episode".to_owned(), Source::Episode(episode, model), false));
        };
        let name =
            path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into());
        if path.extension().is_some_and(|extension| extension == "npz") {
            return Ok((name, Source::Episode(Box::new(Episode::read(path)?), model), false));
        }
        ensure!(
            self.model.model.is_none(),
            "--model: a log holds the module's own decisions; a model is for episodes"
        );
        if path == Path::new(STANDARD_INPUT) {
            let log = Box::new(BufReader::new(stdin()));
            return Ok(("standard input".to_owned(), Source::Log(log), true));
        }
        let file = File::open(path).with_context(|| format!("{}: cannot read the log", path.display()))?;
        Ok((name, Source::Log(Box::new(BufReader::new(file))), false))
    }
}
