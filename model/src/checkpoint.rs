//! A training run on disk: everything needed to go on after the last whole epoch.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use burn::optim::ModuleOptimizer;
use serde::{Deserialize, Deserializer, Serialize};

use crate::output;
use crate::weights::Weights;

const FOLDER: &str = "checkpoint";
const WEIGHTS: &str = "weights.safetensors";
const AVERAGE: &str = "average.safetensors";
const OPTIMIZER: &str = "optimizer.bpk";
const STATE: &str = "state.json";

/// One line of the curves.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    pub epoch: usize,
    pub step: usize,
    /// Learning rate of the last step.
    pub learning_rate: f64,
    /// Mean over the epoch's batches (augmented, balanced), nat.
    pub train_loss: f64,
    /// Validation objects, whole episodes, averaged weights, nat.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_loss: f64,
    /// Share of frames.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_accuracy: f64,
    /// Unweighted mean of the classes' F1.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_macro_f1: f64,
    /// False slip frames as a share of non-slip frames.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_fpr: f64,
    /// Sliding events that the detector misses at a bound of false alarms.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_missed: f64,
    /// Its median delay there, frames.
    #[serde(deserialize_with = "number_or_nan")]
    pub validation_latency: f64,
    /// Wall time since the start, all sessions together, seconds.
    pub seconds: f64,
}

/// JSON has no NaN: a figure that is not there is written as null.
fn number_or_nan<'de, D: Deserializer<'de>>(from: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(from)?.unwrap_or(f64::NAN))
}

pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "epoch,step,learning_rate,train_loss,validation_loss,validation_accuracy,\
         validation_macro_f1,validation_fpr,validation_missed,validation_latency,seconds\n",
    );
    for r in rows {
        text += &format!(
            "{},{},{:.3e},{:.4},{:.4},{:.4},{:.4},{:.4},{:.4},{:.1},{:.1}\n",
            r.epoch,
            r.step,
            r.learning_rate,
            r.train_loss,
            r.validation_loss,
            r.validation_accuracy,
            r.validation_macro_f1,
            r.validation_fpr,
            r.validation_missed,
            r.validation_latency,
            r.seconds
        );
    }
    text
}

#[derive(Debug)]
pub struct Checkpoint {
    /// Weights of the optimizer.
    pub weights: Weights,
    /// Their running average: the result.
    pub average: Weights,
    /// One row per epoch done.
    pub rows: Vec<Row>,
    /// What the run was started with; a resumed run must be the same.
    pub recipe: serde_json::Value,
}

#[derive(Serialize, Deserialize)]
struct State {
    rows: Vec<Row>,
    recipe: serde_json::Value,
}

impl Checkpoint {
    /// Replace the folder's checkpoint by this one: written beside it, then swapped.
    pub fn write(&self, out: &Path, optimizer: &ModuleOptimizer) -> Result<()> {
        let (new, place) = (out.join("checkpoint.new"), out.join(FOLDER));
        let failed = || format!("cannot write {}", place.display());
        let remove = |path: &Path| if path.exists() { fs::remove_dir_all(path) } else { Ok(()) };
        remove(&new).with_context(failed)?;
        fs::create_dir_all(&new).with_context(failed)?;
        self.weights.write(&new.join(WEIGHTS))?;
        self.average.write(&new.join(AVERAGE))?;
        optimizer.save(new.join(OPTIMIZER)).map_err(|e| anyhow!("{e}")).with_context(failed)?;
        let state = State { rows: self.rows.clone(), recipe: self.recipe.clone() };
        output::write(&new.join(STATE), serde_json::to_string_pretty(&state)?.as_bytes())?;
        remove(&place).with_context(failed)?;
        fs::rename(&new, &place).with_context(failed)
    }

    /// Read the folder's checkpoint back; refuses one of a run with another recipe.
    pub fn read(
        out: &Path,
        recipe: &serde_json::Value,
        optimizer: ModuleOptimizer,
    ) -> Result<(Self, ModuleOptimizer)> {
        let place = out.join(FOLDER);
        let path = place.join(STATE);
        let text = output::read(&path).context("no run to resume")?;
        let state: State =
            serde_json::from_slice(&text).with_context(|| format!("cannot use {}", path.display()))?;
        ensure!(
            state.recipe == *recipe,
            "{}: the run was started with {}, now asked for {recipe}",
            path.display(),
            state.recipe
        );
        let weights = Weights::read(&place.join(WEIGHTS))?;
        let average = Weights::read(&place.join(AVERAGE))?;
        let path = place.join(OPTIMIZER);
        let optimizer = optimizer
            .load(&path)
            .map_err(|e| anyhow!("{e}"))
            .with_context(|| format!("cannot use {}", path.display()))?;
        Ok((Self { weights, average, rows: state.rows, recipe: state.recipe }, optimizer))
    }
}
