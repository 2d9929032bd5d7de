//! `slipsense eval`: detectors compared on labelled episodes.

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use slipsense_eval::detectors::{FLOAT, Modality, NETWORK, NETWORK_ALARM, Setup, by_name};
use slipsense_eval::fitted::Fitted;
use slipsense_eval::report;
use slipsense_eval::results::Results;
use slipsense_eval::run::{Candidate, run};

use super::inputs::{Frames, inputs};
use super::{Print, written};
use crate::bundled;
use crate::output::OutputDir;

/// Compare slip detectors on labelled episodes
///
/// Runs every detector over every episode and scores it: latency per event against both truths, false
/// alarms per hour by what caused them, frame metrics, what a threshold trades, with intervals. An input
/// called `val` is not tested on; it fixes the operating point of the report. An input without slip, as
/// `noslip` is, has its false alarms per hour shown by what caused them.
#[derive(clap::Args)]
#[command(after_help = "\
Detectors:
  network  network-alarm  float  entropy  mfcc-qda  entropy-and-mfcc  energy  flux-cusum  band-pass
  logistic  majority  always-slip  clock  rig-only  oracle  oracle-label

Files written to the output folder:
  metrics.json  every number; units are in the keys
  report.html   tables, plots and definitions, one file to share

Where inputs and detectors have the names of the paper's tables (umi_id, umi_ood, palm, tesollo2,
tesollo3; entropy, mfcc-qda, entropy-and-mfcc, network), ours stand beside the paper's. Printed where
the inputs and detectors for it are there, and in both files:
  targets    network on those splits against what it is to reach, mean and deviation over models
  integers   network against float, split by split and seed by seed
  direction  slips by the way they go, with the split free: pulls by hand, twists, the rig's

Examples:
  slipsense eval umi_id umi_ood --out out/eval
  slipsense eval out/episodes --out out/eval
  slipsense eval val umi_id umi_ood --data out/sets --detector entropy --detector mfcc-qda \\
      --detector entropy-and-mfcc --out out/eval
  slipsense eval umi_id umi_ood free --detector network --detector entropy --out out/directions
  slipsense eval umi_id umi_ood --drop piezo --drop xl --out out/dead
  slipsense eval umi_ood --model m.slipnet --detector network --detector float \\
      --weights weights.safetensors --out out/eval
  slipsense eval umi_id umi_ood noslip --frames noslip=8640000 --detector network-alarm --out out/eval
  slipsense eval out/episodes --model seed1.slipnet --model seed2.slipnet --out out/eval --json")]
pub struct Args {
    /// Folders of .npz episodes with labels, or names of splits, whose frozen sets are then generated
    #[arg(value_name = "SPLIT_OR_DIR", required = true)]
    inputs: Vec<String>,
    /// Detector to run; may be given several times
    #[arg(long, value_name = "NAME", default_value = "network")]
    detector: Vec<String>,
    /// Folder to write; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Folder in which splits are looked for first, one folder each, as `synth --all` makes them
    #[arg(long, value_name = "DIR")]
    data: Option<PathBuf>,
    /// Generate at least N frames (240 a second) of the splits among the inputs, or of SPLIT, in place of
    /// their frozen sets, which are their beginning; may be given several times
    #[arg(long, value_name = "[SPLIT=]N", value_parser = Frames::parse)]
    frames: Vec<Frames>,
    /// Model of the network, the bundled one if not given; several are seeds, whose spread is reported
    #[arg(long, value_name = "FILE")]
    model: Vec<PathBuf>,
    /// Weights of the network before quantization, for the detector float; as many as models
    #[arg(long, value_name = "FILE")]
    weights: Vec<PathBuf>,
    /// Fit of the other detectors; the bundled one if not given
    #[arg(long, value_name = "FILE")]
    fit: Option<PathBuf>,
    /// Also evaluate network and network-alarm with this half of every sensor dead: piezo or xl; may be given
    /// twice
    #[arg(long, value_name = "MODALITY")]
    drop: Vec<Modality>,
    #[command(flatten)]
    print: Print,
}

struct Seed {
    /// Behind the detector's name where there are several, else empty.
    suffix: String,
    model: Vec<u8>,
    weights: Option<PathBuf>,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let fitted = match &self.fit {
            Some(path) => Fitted::read(path)?,
            None => Fitted::bundled()?,
        };
        let seeds = self.seeds()?;
        let candidates = self.candidates(&fitted, &seeds)?;
        let inputs = inputs(&self.inputs, self.data.as_deref(), &self.frames)?;
        let out = OutputDir::prepare(&self.out)?;

        let episodes = inputs.iter().map(|input| input.episodes.len()).sum();
        let progress = self.print.progress(episodes, "episodes");
        let predicted = run(&inputs, &candidates, &|| progress.inc(1))?;
        progress.finish_and_clear();
        let results = Results::new(&inputs, &candidates, &predicted, &pairs(&candidates, &seeds));
        out.write("metrics.json", serde_json::to_string_pretty(&results)? + "\n")?;
        out.write("report.html", report::html(&results, &predicted)?)?;
        out.commit()?;
        self.print.show(&results, || {
            let files = written(&self.out, &[("report", "report.html"), ("numbers", "metrics.json")]);
            let (wall_s, threads) = (results.wall_s, results.threads);
            format!("{results}\n{files}  evaluated in  {wall_s:.1} s on {threads} threads\n")
        })
    }

    fn seeds(&self) -> Result<Vec<Seed>> {
        if self.model.is_empty() {
            let count = self.weights.len();
            ensure!(count <= 1, "--weights: {count} files, but one model, the bundled one");
            let weights = self.weights.first().cloned();
            return Ok(vec![Seed { suffix: String::new(), model: bundled::MODEL.to_vec(), weights }]);
        }
        if !self.weights.is_empty() && self.weights.len() != self.model.len() {
            bail!("--weights: {} files, but {} models", self.weights.len(), self.model.len());
        }
        let seed = |(i, path): (usize, &PathBuf)| {
            let model = bundled::model(Some(path))?.bytes;
            let suffix = if self.model.len() > 1 { format!("#{}", i + 1) } else { String::new() };
            Ok(Seed { suffix, model, weights: self.weights.get(i).cloned() })
        };
        self.model.iter().enumerate().map(seed).collect()
    }

    /// All detectors asked for, each made once here so that what is wrong shows before any work is done.
    fn candidates<'a>(&'a self, fitted: &'a Fitted, seeds: &'a [Seed]) -> Result<Vec<Candidate<'a>>> {
        if !self.drop.is_empty()
            && !self.detector.iter().any(|d| [NETWORK, NETWORK_ALARM].contains(&d.as_str()))
        {
            bail!(
                "--drop: only {NETWORK} and {NETWORK_ALARM} run on half a sensor, and neither is a --detector"
            );
        }
        for (i, dropped) in self.drop.iter().enumerate() {
            if self.drop[..i].contains(dropped) {
                bail!("--drop: {} given twice", dropped.name());
            }
        }
        let mut candidates: Vec<Candidate<'a>> = Vec::new();
        for (i, family) in self.detector.iter().enumerate() {
            if self.detector[..i].contains(family) {
                continue;
            }
            let of_seed = [NETWORK, NETWORK_ALARM, FLOAT].contains(&family.as_str());
            let seeds = if of_seed { seeds } else { &seeds[..1] };
            let may_drop = [NETWORK, NETWORK_ALARM].contains(&family.as_str());
            let dropped = self.drop.iter().copied().map(Some).filter(|_| may_drop);
            for dead in std::iter::once(None).chain(dropped) {
                let without = dead.map_or_else(String::new, |dead| format!("-without-{}", dead.name()));
                for seed in seeds {
                    let float_weights = seed.weights.as_deref();
                    let setup = Setup { fitted, model: &seed.model, float_weights, dead };
                    let make = move || by_name(family, &setup);
                    drop(make()?);
                    // A name of its own: what is written of the network is not said of half a sensor.
                    let family = format!("{family}{without}");
                    let name = format!("{family}{}", if seeds.len() > 1 { &seed.suffix } else { "" });
                    candidates.push(Candidate { name, family, make: Box::new(make) });
                }
            }
        }
        Ok(candidates)
    }
}

/// Positions of the integer and the float network of each seed.
fn pairs(candidates: &[Candidate<'_>], seeds: &[Seed]) -> Vec<(usize, usize)> {
    let position = |family: &str, seed: &Seed| {
        candidates.iter().position(|e| e.family == family && e.name == format!("{family}{}", seed.suffix))
    };
    let pair = |seed: &Seed| Some((position(NETWORK, seed)?, position(FLOAT, seed)?));
    seeds.iter().filter_map(pair).collect()
}
