//! `cargo xtask qemu`: the same frames on the emulated microcontroller and here, compared bit for bit.

use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use clap::Args;
use slipsense::net::Model;
use slipsense::params::MAX_SENSORS;
use slipsense_qemu::input::MODEL_BYTES_MAX;
use slipsense_recording::Episode;

use crate::root;

mod compare;
mod emulator;
mod extreme;
pub mod frames;
mod host;
pub mod machine;
mod real_time;
mod report;
pub mod trace;

use emulator::Emulator;
use frames::Frames;
use report::Report;

/// Comparing the kernels takes seconds.
const KERNELS_TIMEOUT: Duration = Duration::from_secs(300);

/// What to run, on which model.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Builds the program of tests/qemu for the Cortex-M7, starts it in QEMU (machine mps2-an500), feeds it \
every frame through a file and compares what comes back with what the same library computes here: \
log-mel features, logits, class, slip flag, alarm, health and every byte of every CAN frame.

Exit code: 0 all equal, 1 something differs, 2 it could not be run.

Examples:
  cargo xtask qemu host-tools/cli/demo/episode.npz
  cargo xtask qemu --extreme --frames 2000 --json
  cargo xtask qemu --extreme --random-model 7
  cargo xtask qemu host-tools/cli/demo/episode.npz --compress-raw
  cargo xtask qemu --real-time host-tools/cli/demo/episode.npz
  cargo xtask qemu --real-time host-tools/cli/demo/episode.npz --seconds 5")]
pub struct Options {
    /// Episode files (.npz), one run each
    #[arg(value_name = "EPISODE", required_unless_present = "extreme")]
    pub episodes: Vec<PathBuf>,
    /// Also run extreme generated input, once for each number of sensors
    #[arg(long)]
    pub extreme: bool,
    /// Frames to run: of each episode at most (default: all), of extreme input in total (default: 2000)
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..))]
    pub frames: Option<u32>,
    /// Seed of the extreme input
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Model file
    #[arg(long, default_value_os_t = default_model(), hide_default_value = true, conflicts_with = "random_model")]
    pub model: PathBuf,
    /// Instead of a model file: a random network of random shape, made from this seed
    #[arg(long, value_name = "SEED")]
    pub random_model: Option<u64>,
    /// Loop the episode against the clock instead: frames at 240 Hz that nobody waits for, with one and with three
    /// sensors, on a bus that is free, full, disturbed and gone
    #[arg(long, requires = "episodes", conflicts_with_all = ["extreme", "frames", "random_model"])]
    pub real_time: bool,
    /// Emulated seconds of each real-time run
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(3..=600), requires = "real_time")]
    pub seconds: u32,
    /// Send the raw messages compressed (register slipsense.raw.compressed); against the clock both ways are run
    #[arg(long, conflicts_with = "real_time")]
    pub compress_raw: bool,
    /// Print one JSON object on standard output instead of a table
    #[arg(long)]
    pub json: bool,
    /// Seconds that one run may take
    #[arg(long, default_value_t = 900)]
    pub timeout_s: u64,
}

const EXTREME_FRAMES: u32 = 2000;

/// The model of the repository.
pub fn default_model() -> PathBuf {
    root().join("model/weights/slipsense.slipnet")
}

impl Options {
    /// Run episodes on the model of the repository.
    pub fn episodes(episodes: Vec<PathBuf>) -> Self {
        Self {
            episodes,
            extreme: false,
            frames: None,
            seed: 1,
            model: default_model(),
            random_model: None,
            real_time: false,
            seconds: 60,
            compress_raw: false,
            json: false,
            timeout_s: 900,
        }
    }

    /// Run an episode against the clock.
    pub fn in_real_time(episode: PathBuf, seconds: u32) -> Self {
        Self { real_time: true, seconds, ..Self::episodes(vec![episode]) }
    }

    /// Run extreme input, on the model of the repository or a random one.
    pub fn extreme(frames: u32, random_model: Option<u64>) -> Self {
        Self { extreme: true, frames: Some(frames), random_model, ..Self::episodes(Vec::new()) }
    }

    fn model(&self) -> Result<(String, Vec<u8>)> {
        let (name, bytes) = match self.random_model {
            Some(seed) => (format!("random {seed}"), extreme::model(seed)?),
            None => {
                let bytes = std::fs::read(&self.model)
                    .with_context(|| format!("{}: cannot read the model", self.model.display()))?;
                (self.model.display().to_string(), bytes)
            }
        };
        if bytes.len() > MODEL_BYTES_MAX {
            bail!("{name}: {} bytes, the emulated board takes {MODEL_BYTES_MAX}", bytes.len());
        }
        Model::parse(&bytes).with_context(|| format!("{name}: not a usable model"))?;
        Ok((name, bytes))
    }

    /// The runs, in order; each is made when its turn comes.
    fn runs(&self) -> Vec<Run<'_>> {
        let episodes = self.episodes.iter().map(|path| Run::Episode { path, limit: self.frames });
        let total = self.frames.unwrap_or(EXTREME_FRAMES);
        let extremes = (1..=MAX_SENSORS as u32).map(|sensors| Run::Extreme {
            // The first runs take what does not divide evenly.
            frames: (total + MAX_SENSORS as u32 - sensors) / MAX_SENSORS as u32,
            sensors: sensors as usize,
            seed: self.seed,
        });
        episodes.chain(extremes.filter(|_| self.extreme)).collect()
    }
}

enum Run<'a> {
    Episode { path: &'a PathBuf, limit: Option<u32> },
    Extreme { frames: u32, sensors: usize, seed: u64 },
}

impl Run<'_> {
    fn frames(&self) -> Result<(String, Frames)> {
        match *self {
            Self::Episode { path, limit } => {
                let episode = Episode::read(path)?;
                let frames =
                    Frames::of_episode(&episode, limit).with_context(|| path.display().to_string())?;
                Ok((path.display().to_string(), frames))
            }
            Self::Extreme { frames, sensors, seed } => {
                Ok((format!("extreme input, {sensors} sensors"), extreme::frames(frames, sensors, seed)))
            }
        }
    }
}

/// Compare the kernels of the Cortex-M7 with the portable ones; fails where a call differs.
pub fn kernels() -> Result<()> {
    let machine = machine::Machine::build("slipsense-qemu-kernels", &[])?;
    let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
    machine.run(dir.path(), KERNELS_TIMEOUT)?;
    let said =
        std::fs::read_to_string(dir.path().join("log")).context("the emulated program said nothing")?;
    if !said.contains("conv_relu_pool: 0 of") {
        bail!("the emulated program did not compare the kernels:\n{said}");
    }
    print!("{said}");
    Ok(())
}

/// Run and report; `false` if something differed.
pub fn run(options: &Options) -> Result<bool> {
    let (model_name, model) = options.model()?;
    if options.real_time {
        let [episode] = options.episodes.as_slice() else {
            bail!("--real-time: {} episodes given, it loops one", options.episodes.len());
        };
        let timeout = Duration::from_secs(options.timeout_s);
        return real_time::run(episode, &model, options.seconds, options.json, timeout);
    }
    let emulator = Emulator::build()?;
    let mut report = Report::new(model_name);
    for run in options.runs() {
        let (name, mut frames) = run.frames()?;
        frames.compress_raw = options.compress_raw;
        if frames.is_empty() {
            continue;
        }
        eprintln!("{name}: {} frames on the emulated Cortex-M7", frames.len());
        let (expected, host_time) = host::records(&frames, &model)?;
        let output = emulator.run(&frames, &model, Duration::from_secs(options.timeout_s))?;
        let comparison = compare::compare(&expected, &output.records);
        for mismatch in &comparison.first {
            eprintln!("  {mismatch}");
        }
        report.add(name, frames.sensors(), &output, host_time, comparison);
    }
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{report}");
    }
    Ok(report.all_equal())
}
