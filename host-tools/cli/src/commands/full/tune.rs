//! `slipsense tune`: the operating point of a model, chosen on validation data.

use std::path::PathBuf;

use anyhow::{Context, Result, anyhow, ensure};
use serde_json::Value;
use slipsense::net::Model;
use slipsense_eval::tune::{Tuning, disturbances, margins, slips, tune};
use slipsense_recording::model_file::ModelFile;

use super::Print;
use crate::bundled;
use crate::output::{check_file, write_file};

/// Choose a model's operating point: threshold and k-of-n of its flag
///
/// The flag is up while the log-odds of slip of at least k of the last n frames are over a threshold. For
/// each of a few k of n the threshold is the lowest that keeps to the allowed false alarms per hour, on
/// generated minutes of disturbances and between the slips of the validation splits; an alarm while most of
/// the contact slides is not false. Of these points that one is chosen that finds most of the sustained sliding
/// within 50 ms, then the one that misses least. All episodes are of validation objects, in the laboratory's
/// physics and in others. Training has none of these objects; of the tests, `noslip` and `transfer_noslip` have
/// them in a third of their episodes, with other seeds. The weights stay as they are; the same model gives the
/// same point.
#[derive(clap::Args)]
#[command(after_help = "\
The figures are of the data that the point was chosen on. What it is worth, tests say:
  slipsense eval umi_ood noslip --detector network-alarm --model tuned.slipnet --out out/eval

Examples:
  slipsense tune model.slipnet --out tuned.slipnet
  slipsense tune model.slipnet --out tuned.slipnet --per-hour 0.5 --curve curve.svg
  slipsense tune model.slipnet --out quick.slipnet --hours 0.25 --episodes 16 --per-hour 8")]
pub struct Args {
    /// Model file whose point is chosen
    #[arg(value_name = "MODEL")]
    model: PathBuf,
    /// Model file to write: the same network with its new point; may be MODEL itself
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Hours of disturbances without slip to generate, 1/60 to 100; twelve take some minutes
    #[arg(long, value_name = "H", default_value_t = 12.0)]
    hours: f64,
    /// Episodes of the validation splits to generate
    #[arg(long, value_name = "N", default_value_t = 160, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    episodes: u32,
    /// False alarms per hour that are allowed: fewer cost delay and misses
    #[arg(long, value_name = "R", default_value_t = 1.0, allow_negative_numbers = true)]
    per_hour: f64,
    /// Draw delay and misses against false alarms per hour
    #[arg(long, value_name = "FILE.svg")]
    curve: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

impl Args {
    pub fn run(self) -> Result<()> {
        ensure!((1.0 / 60.0..=100.0).contains(&self.hours), "--hours is {}, must be 1/60 to 100", self.hours);
        let rate = self.per_hour;
        ensure!(rate.is_finite() && rate >= 0.0, "--per-hour is {rate}, must be 0 or more");
        let source = bundled::model(Some(&self.model))?;
        let model = source.parse()?;
        let mut file =
            ModelFile::from_bytes(&source.bytes).with_context(|| format!("model {}", source.name))?;
        check_file(&self.out)?;
        self.curve.as_deref().map(check_file).transpose()?;

        let inputs = [disturbances(self.hours), slips(self.episodes as usize)];
        let episodes = inputs.iter().map(|input| input.episodes.len()).sum();
        let [quiet, slipping] = self
            .print
            .progress(episodes, "episodes", |bar| inputs.map(|input| margins(&input, model, &|| bar.inc(1))));
        let tuning = tune(&quiet?, &slipping?, rate)?;

        file.point = tuning.best().point();
        file.provenance = self.provenance(&file.provenance, &tuning).to_string();
        let tuned = file.to_bytes().map_err(|error| anyhow!("the tuned model: {error}"))?;
        Model::parse(&tuned).context("the tuned model")?;
        write_file(&self.out, &tuned)?;
        if let Some(path) = &self.curve {
            write_file(path, tuning.curve_svg()?.as_bytes())?;
        }
        self.print.show(&tuning, || format!("{tuning}\n  model         {}\n", self.out.display()))
    }

    /// What the model's provenance says, and on what its point was chosen.
    fn provenance(&self, before: &str, tuning: &Tuning) -> Value {
        // The format does not demand JSON of who wrote the model.
        let mut all = match serde_json::from_str(before) {
            Ok(Value::Object(all)) => all,
            Ok(other) => serde_json::Map::from_iter([("model".to_owned(), other)]),
            Err(_) => serde_json::Map::from_iter([("model".to_owned(), before.into())]),
        };
        all.insert("operating_point".to_owned(), tuning.provenance(self.episodes));
        all.into()
    }
}
