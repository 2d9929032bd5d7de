//! `slipsense eval`: detectors compared on labelled episodes.

use std::fs;
use std::io::ErrorKind;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use serde_json::json;
use sha2::{Digest, Sha256};
use slipsense_eval::detectors::{FLOAT, Modality, NETWORK, NETWORK_ALARM, Setup, by_name};
use slipsense_eval::fitted::Fitted;
use slipsense_eval::report;
use slipsense_eval::results::Results;
use slipsense_eval::run::{Candidate, Part, episodes_of, join, run_part};
use slipsense_eval::source::{Handle, Input};
use slipsense_synth::Shard;

use super::inputs::{Frames, inputs};
use super::{Print, written};
use crate::bundled;
use crate::output::{OutputDir, is_partial, refuse_file, write_file};

/// Compare slip detectors on labelled episodes
///
/// Runs every detector over every episode and scores it: latency per event against both truths, false
/// alarms per hour by what caused them, frame metrics, what a threshold trades, with intervals. An input
/// called `val` is not tested on; it fixes the operating point of the report. An input without slip, as
/// `noslip` is, has its false alarms per hour shown by what caused them.
#[derive(clap::Args)]
#[command(after_help = "\
Detectors:
  network  network-alarm  float  entropy  mfcc-qda  entropy-and-mfcc  majority  always-slip  clock
  rig-only  idle-noise  oracle  oracle-label

Files written to the output folder:
  metrics.json  every number; units are in the keys
  report.html   tables, plots and definitions, one file to share

Parts made by several processes or machines (--shard, same command else) meet in one output folder as
parts/part-I-of-N.bin; the last one writes the result of the whole and removes them. An input is
eight streams, which the parts share out: more parts than streams find nothing to do.

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
  slipsense eval umi_id umi_ood --out out/eval --shard 2/4
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
    /// Evaluate only part I of N of the streams
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    shard: Option<Shard>,
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
        match self.evaluate()? {
            Some(results) => self.print.show(&results, || {
                let files = written(&self.out, &[("report", "report.html"), ("numbers", "metrics.json")]);
                let (wall_s, threads) = (results.wall_s, results.threads);
                format!("{results}\n{files}  evaluated in  {wall_s:.1} s on {threads} threads\n")
            }),
            None => {
                let part = self.shard.unwrap_or(Shard::WHOLE).to_string();
                let made = json!({"part": part, "complete": false});
                self.print.show(&made, || format!("part {part} evaluated, others missing\n"))
            }
        }
    }

    /// Results, written to the folder; none where other parts are missing.
    pub fn evaluate(&self) -> Result<Option<Results>> {
        let fitted = self.fit.as_deref().map_or_else(Fitted::bundled, Fitted::read)?;
        let seeds = self.seeds()?;
        let candidates = self.candidates(&fitted, &seeds)?;
        let inputs = inputs(&self.inputs, self.data.as_deref(), &self.frames)?;
        let shard = self.shard.unwrap_or(Shard::WHOLE);
        let files =
            PartFiles { folder: self.out.join(PARTS), shard, key: self.key(&inputs, &candidates, &seeds)? };
        // That the output can be written, before any work is done.
        match self.shard {
            None => drop(OutputDir::prepare(&self.out)?),
            Some(_) => files.begin()?,
        }
        let has = |stream| shard.has(stream);
        let part = self.print.progress(episodes_of(&inputs, has), "episodes", |bar| {
            run_part(&inputs, &candidates, has, &|| bar.inc(1))
        })?;
        let parts = if self.shard.is_some() { files.add(&part)? } else { Some(vec![part]) };
        let Some(parts) = parts else { return Ok(None) };
        let predicted = join(&inputs, candidates.len(), parts);
        let results = Results::new(&inputs, &candidates, &predicted, &pairs(&candidates, &seeds));
        let out = OutputDir::prepare(&self.out)?;
        out.write("metrics.json", serde_json::to_string_pretty(&results)? + "\n")?;
        out.write("report.html", report::html(&results, &predicted)?)?;
        out.commit()?;
        if self.shard.is_some() {
            files.remove()?;
        }
        Ok(Some(results))
    }

    /// What parts of one evaluation have in common.
    fn key(&self, inputs: &[Input], candidates: &[Candidate<'_>], seeds: &[Seed]) -> Result<[u8; 32]> {
        let mut key = Sha256::new_with_prefix(env!("CARGO_PKG_VERSION"));
        for input in inputs {
            key.update(format!("{:?}", (&input.name, input.episodes.len())));
            for episode in &input.episodes {
                let bytes = match episode {
                    Handle::File(path) => fs::metadata(path).map_or(0, |file| file.len()),
                    Handle::Recipe { .. } => 0,
                };
                key.update(format!("{:?}", (episode.name(), bytes)));
            }
        }
        candidates.iter().for_each(|candidate| key.update(format!("{:?}", candidate.name)));
        seeds.iter().for_each(|seed| key.update(&seed.model));
        for file in self.fit.iter().chain(&self.weights) {
            key.update(fs::read(file).with_context(|| file.display().to_string())?);
        }
        Ok(key.finalize().into())
    }

    fn seeds(&self) -> Result<Vec<Seed>> {
        let (models, weights) = (self.model.len(), self.weights.len());
        ensure!(models > 0 || weights <= 1, "--weights: {weights} files, but one model, the bundled one");
        ensure!(
            models == 0 || weights == 0 || weights == models,
            "--weights: {weights} files, but {models} models"
        );
        let seed = |i: usize| {
            let suffix = if models > 1 { format!("#{}", i + 1) } else { String::new() };
            let model = bundled::model(self.model.get(i).map(PathBuf::as_path))?.bytes;
            Ok(Seed { suffix, model, weights: self.weights.get(i).cloned() })
        };
        (0..models.max(1)).map(seed).collect()
    }

    /// All detectors asked for, each made once here so that what is wrong shows before any work is done.
    fn candidates<'a>(&'a self, fitted: &'a Fitted, seeds: &'a [Seed]) -> Result<Vec<Candidate<'a>>> {
        let may_drop = |family: &String| [NETWORK, NETWORK_ALARM].contains(&family.as_str());
        ensure!(
            self.drop.is_empty() || self.detector.iter().any(may_drop),
            "--drop: only {NETWORK} and {NETWORK_ALARM} run on half a sensor, and neither is a --detector"
        );
        for (i, dropped) in self.drop.iter().enumerate() {
            ensure!(!self.drop[..i].contains(dropped), "--drop: {} given twice", dropped.name());
        }
        let mut candidates: Vec<Candidate<'a>> = Vec::new();
        for (i, family) in self.detector.iter().enumerate() {
            if self.detector[..i].contains(family) {
                continue;
            }
            let seeds = if may_drop(family) || family == FLOAT { seeds } else { &seeds[..1] };
            let dropped = self.drop.iter().copied().map(Some).filter(|_| may_drop(family));
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

/// Folder of the parts inside that of the results.
const PARTS: &str = "parts";

/// The parts of one evaluation as files: its key, then what the streams gave.
struct PartFiles {
    /// Holds nothing else, so that what a killed process left can be removed.
    folder: PathBuf,
    shard: Shard,
    key: [u8; 32],
}

impl PartFiles {
    /// Make the folder, which shows that results can be written.
    fn begin(&self) -> Result<()> {
        self.folder.parent().map_or(Ok(()), refuse_file)?;
        fs::create_dir_all(&self.folder)
            .with_context(|| format!("{}: cannot write this folder", self.folder.display()))
    }

    fn file(&self, shard: Shard) -> PathBuf {
        self.folder.join(format!("part-{}.bin", shard.file_part()))
    }

    /// Write ours, and read all if they are there. One of another evaluation counts as missing.
    fn add(&self, part: &Part) -> Result<Option<Vec<Part>>> {
        // Another part's process may have removed it with the others' parts.
        self.begin()?;
        write_file(&self.file(self.shard), [&self.key[..], &part.to_bytes()?].concat())?;
        let read = |shard| match fs::read(self.file(shard)) {
            Ok(bytes) => Ok(bytes.strip_prefix(&self.key[..]).and_then(Part::from_bytes)),
            // Another part's process that ended at the same time may have written the result already.
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error).with_context(|| format!("{}: cannot read", self.file(shard).display())),
        };
        self.shard.all().map(read).collect()
    }

    /// The parts, and what killed processes left of theirs. All parts are there: no other process writes one.
    fn remove(&self) -> Result<()> {
        let left = fs::read_dir(&self.folder).into_iter().flatten().flatten().map(|entry| entry.path());
        let mut files =
            self.shard.all().map(|shard| self.file(shard)).chain(left.filter(|path| is_partial(path)));
        files.try_for_each(|file| match fs::remove_file(&file) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                Err(error).with_context(|| format!("{}: cannot remove", file.display()))
            }
            _ => Ok(()),
        })?;
        // Parts of another evaluation keep it.
        let _ = fs::remove_dir(&self.folder);
        Ok(())
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
