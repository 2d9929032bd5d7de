//! `slipsense model compare`: float against integer, layer by layer.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::{Context, Result};
use serde::Serialize;
use slipsense_model::compare::{ActivationError, LayerComparison, compare_activations};
use slipsense_model::output::sha256_hex;
use slipsense_model::weights::Weights;
use slipsense_recording::Episode;

use crate::bundled;
use crate::commands::Print;
use crate::summary::{EpisodeInfo, ModelInfo};

/// Compare float and integer network layer by layer over one episode
///
/// Both networks see the same features and run freely, each from its own past; the integers of every layer are
/// turned into real values by the scales in the model file. An error shown at a layer is what all integers up
/// to it added up to. The inputs are integers to begin with, so they must be exact.
#[derive(clap::Args)]
#[command(after_help = "\
Columns:
  rms, largest   of the float values, real units
  worst error    largest difference of a single value, real units
  SNR            power of the float values over that of the differences, dB

Examples:
  slipsense model compare grasp.npz
  slipsense model compare grasp.npz --model new.slipnet --weights new.safetensors
  slipsense model compare grasp.npz --json | jq '.activations[] | {activation, snr_db}'")]
pub struct Args {
    /// Episode to run, an .npz file; labels are not needed
    #[arg(value_name = "EPISODE.npz")]
    episode: PathBuf,
    /// Model file; the bundled one if not given
    #[arg(long, value_name = "FILE", requires = "weights")]
    model: Option<PathBuf>,
    /// The float weights that the model was quantized from
    #[arg(long, value_name = "FILE", requires = "model")]
    weights: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

#[derive(Serialize)]
struct Report {
    episode: EpisodeInfo,
    model: ModelInfo,
    /// Name of the weights' file, or `bundled`.
    weights: String,
    /// Does the model's provenance name these weights? `null` if it names none.
    weights_are_the_models: Option<bool>,
    same_class_share: Option<f64>,
    #[serde(flatten)]
    comparison: LayerComparison,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let source = bundled::model(self.model.as_deref())?;
        let (model, model_name) = (source.parse()?, &source.name);
        let (weights, weights_name) = match &self.weights {
            Some(path) => (Weights::read(path)?, path.display().to_string()),
            None => {
                let weights = Weights::from_bytes(bundled::WEIGHTS).context("bundled weights")?;
                (weights, bundled::NAME.to_owned())
            }
        };
        let episode = Episode::read(&self.episode)?;
        let comparison = compare_activations(model, &weights, &episode)
            .with_context(|| format!("model {model_name}, weights {weights_name}"))?;
        let model = ModelInfo::new(&model, model_name);
        let made_from = model.provenance.get("weights_sha256").and_then(|hash| hash.as_str());
        let hash = sha256_hex(&weights.to_bytes()?);
        let report = Report {
            episode: EpisodeInfo::new(&episode, &self.episode.display().to_string()),
            weights_are_the_models: made_from.map(|made_from| made_from == hash),
            weights: weights_name,
            model,
            same_class_share: comparison.agreement(),
            comparison,
        };
        self.print.show(&report, || report.table())
    }
}

impl Report {
    fn table(&self) -> String {
        let Self { weights, .. } = self;
        let (episode, model, hash) = (self.episode.words(), &self.model.name, &self.model.hash[..12]);
        let mut text = format!("{episode}\nmodel:   {model}, hash {hash}…\nweights: {weights}\n");
        if self.weights_are_the_models == Some(false) {
            text += "         not the weights that the model was made from\n";
        }
        text += &format!(
            "\n  {:22} {:>11} {:>11} {:>13} {:>9}\n",
            "activation", "rms", "largest", "worst error", "SNR"
        );
        for one in &self.comparison.activations {
            let ActivationError { activation, rms, largest, worst_error, .. } = one;
            let snr = match one.snr_db {
                Some(snr_db) => format!("{snr_db:.1} dB"),
                None if *worst_error == 0.0 => "exact".to_owned(),
                None => "–".to_owned(),
            };
            let _ =
                writeln!(text, "  {activation:22} {rms:>11.4} {largest:>11.4} {worst_error:>13.5} {snr:>9}");
        }
        text + &self.verdict()
    }

    /// One line: do the integers decide as the floats do?
    fn verdict(&self) -> String {
        let LayerComparison { frames, agreed, differing_frames, .. } = &self.comparison;
        let share = self.same_class_share.map_or("–".to_owned(), |share| format!("{:.2} %", 100.0 * share));
        let mut text = format!("\nsame class in {share} of frames ({agreed} of {frames})");
        if let Some(first) = differing_frames.first() {
            let _ = write!(text, ", first different at frame {first}");
        }
        let logits = self.comparison.activation("logits").and_then(|logits| logits.snr_db);
        if let Some(snr_db) = logits {
            let _ = write!(text, "; logits {snr_db:.1} dB over the integers' error");
        }
        text + "\n"
    }
}
