//! `slipsense view`: recordings or a live bus on a page of this computer.

use std::fs::File;
use std::io::{BufRead, BufReader, Cursor, Read, Seek, stdin};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use slipsense::params::FRAME_RATE_HZ;
use slipsense::wire::NodeId;
use slipsense_recording::EpisodeReader;
use slipsense_recording::log_file::Format;
use slipsense_view::frames::{Frames, Session};
use slipsense_view::source;

use super::convert::node_id;
use super::print;
use crate::bundled::{self, NamedModel};
use crate::page_server::{PageServer, Shared};
use crate::summary::file_name;

const STANDARD_INPUT: &str = "-";
/// Columns of the page.
const SESSIONS_MAX: usize = 4;

/// Show recordings or a live bus on a page of this computer
///
/// Pressure maps, log-mel, logits, flags, events and health of up to three sensors, with the truth where an
/// episode has labels. Opens nothing to the network: the page is served to this computer only, and works without
/// internet. An episode goes through the pipeline here, and is shown while the rest of it is read; of a log or a bus
/// the module's own decisions are shown, and its samples become log-mel here. Several recordings, or several models,
/// are shown side by side.
#[derive(clap::Args)]
#[command(after_help = "\
On the page: space plays and pauses, the arrows step a frame (with shift a second), n and p go to the
next and previous event, home and end to the ends; the strip at the bottom is the whole recording, click it.

Examples:
  slipsense view                                  the bundled synthetic episode
  slipsense view grasp.npz --port 8421
  slipsense view before.npz after.npz             two recordings side by side
  slipsense view grasp.npz --model bundled --model mine.slipnet    two models
  slipsense view out/demo/can.log                 a candump log
  candump -L can0 | slipsense view - --node 42    a live bus
  slipsense view - < can.log                      a log as if it were live

Ends with Ctrl-C.")]
pub struct Args {
    /// Episodes (.npz), candump logs, or - for a candump log on standard input, which may be a live bus; the
    /// bundled episode if none is given
    #[arg(value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Port of this computer to serve the page on; 0 takes any that is free
    #[arg(long, value_name = "PORT", default_value_t = 8420)]
    port: u16,
    /// Address of the module on the bus, for logs
    #[arg(long, value_name = "ID", default_value = "42", value_parser = node_id)]
    node: NodeId,
    /// Model file, or `bundled`; may be given several times
    #[arg(long, value_name = "FILE", default_value = bundled::NAME)]
    model: Vec<PathBuf>,
    /// Keep this many seconds; older frames are dropped. An hour of three sensors takes gigabytes of memory
    #[arg(long, value_name = "S", default_value_t = 3600, value_parser = clap::value_parser!(u32).range(1..=86400))]
    keep_s: u32,
}

/// What an episode is read from.
trait Input: Read + Seek + Send {}
impl<T: Read + Seek + Send> Input for T {}

/// Takes all frames of a recording; an error where they end by a fault.
type Source = Box<dyn FnOnce(&Shared) -> Result<(), String> + Send>;

impl Args {
    pub fn run(self) -> Result<()> {
        let sources = self.sources()?;
        let count = sources.len();
        ensure!(
            count <= SESSIONS_MAX,
            "{count} recordings and models: the page shows at most {SESSIONS_MAX}"
        );
        let server = PageServer::bind(self.port)?;
        let keep = self.keep_s as usize * FRAME_RATE_HZ as usize;
        let since = SystemTime::now().duration_since(UNIX_EPOCH);
        let id = since.map_or(0, |since| since.as_millis() as u64);
        let (sessions, sources): (Vec<_>, Vec<_>) = sources
            .into_iter()
            .map(|(session, source)| (Shared::new(Frames::new(Session { id, ..session }, keep)), source))
            .unzip();
        let sessions = Arc::new(sessions);
        for (index, source) in sources.into_iter().enumerate() {
            let sessions = Arc::clone(&sessions);
            thread::spawn(move || {
                let problem = source(&sessions[index]).err();
                problem.iter().for_each(|problem| eprintln!("error: {problem}"));
                sessions[index].end(problem);
            });
        }
        print(&format!("{}\n", server.url()))?;
        server.serve(&sessions);
        Ok(())
    }

    /// Each recording with each model; a log, which holds its module's decisions, once.
    fn sources(&self) -> Result<Vec<(Session, Source)>> {
        let standard_input = self.files.iter().filter(|path| *path == Path::new(STANDARD_INPUT)).count();
        ensure!(standard_input <= 1, "-: standard input can be read once, not {standard_input} times");
        for model in &self.model {
            named_model(model)?;
        }
        let bundled = [PathBuf::from(bundled::NAME)];
        let files = if self.files.is_empty() { &bundled[..] } else { &self.files };
        let mut sources = Vec::new();
        for path in files {
            if self.files.is_empty() || path.extension().is_some_and(|extension| extension == "npz") {
                for model in &self.model {
                    sources.push(self.episode(path, model)?);
                }
            } else {
                ensure!(
                    self.model.iter().all(|model| model == Path::new(bundled::NAME)),
                    "--model: a log holds the module's own decisions; a model is for episodes"
                );
                ensure!(
                    Format::from_path(path) != Some(Format::Mcap),
                    "{}: an MCAP recording; `slipsense convert` makes a log (.log) of it, which can be shown",
                    path.display()
                );
                sources.push(self.log(path)?);
            }
        }
        Ok(sources)
    }

    fn episode(&self, path: &Path, model: &Path) -> Result<(Session, Source)> {
        let (input, path): (Box<dyn Input>, _) = if self.files.is_empty() {
            (Box::new(Cursor::new(bundled::EPISODE)), Path::new("bundled episode"))
        } else {
            let file = File::open(path).with_context(|| format!("{}: cannot read", path.display()))?;
            (Box::new(BufReader::with_capacity(1 << 16, file)), path)
        };
        let mut file = EpisodeReader::new(input, path)?;
        let model = named_model(model)?;
        let session = Session::of_episode(file_name(path), model.name.clone(), file.episode());
        let run = move |to: &Shared| {
            let model = model.parse().map_err(|error| format!("{error:#}"))?;
            to.fill(source::episode(&mut file, model).map_err(|problem| problem.to_string())?)
        };
        Ok((session, Box::new(run)))
    }

    fn log(&self, path: &Path) -> Result<(Session, Source)> {
        let is_live = path == Path::new(STANDARD_INPUT);
        let (log, name): (Box<dyn BufRead + Send>, _) = if is_live {
            (Box::new(BufReader::new(stdin())), "standard input".to_owned())
        } else {
            let file =
                File::open(path).with_context(|| format!("{}: cannot read the log", path.display()))?;
            (Box::new(BufReader::with_capacity(1 << 16, file)), file_name(path))
        };
        let (node, called) = (self.node, if is_live { name.clone() } else { path.display().to_string() });
        let named = move |error| format!("{called}: {error}");
        let run = move |to: &Shared| to.fill(source::log(log, node).map(|record| record.map_err(&named)));
        Ok((Session::of_log(name, is_live), Box::new(run)))
    }
}

/// A model that can be used.
fn named_model(path: &Path) -> Result<NamedModel> {
    let model = bundled::model(Some(path).filter(|path| *path != Path::new(bundled::NAME)))?;
    model.parse()?;
    Ok(model)
}
