//! A training run on disk: everything needed to go on after the last whole epoch.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, anyhow, ensure};
use burn::optim::ModuleOptimizer;
use serde::{Deserialize, Serialize};

use crate::output;
use crate::weights::Weights;

const FOLDER: &str = "checkpoint";
const NEW: &str = "checkpoint.new";
const WEIGHTS: &str = "weights.safetensors";
const AVERAGE: &str = "average.safetensors";
const OPTIMIZER: &str = "optimizer.bpk";
/// Written last: what has it is whole.
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
    pub validation_loss: Option<f64>,
    /// Share of frames.
    pub validation_accuracy: Option<f64>,
    /// Unweighted mean of the classes' F1.
    pub validation_macro_f1: Option<f64>,
    /// False slip frames as a share of non-slip frames.
    pub validation_fpr: Option<f64>,
    /// Sliding events that the detector misses at a bound of false alarms.
    pub validation_missed: Option<f64>,
    /// Its median delay there, frames.
    pub validation_latency: Option<f64>,
    /// Wall time since the start, all sessions together, seconds.
    pub seconds: f64,
}

pub fn csv(rows: &[Row]) -> String {
    let mut text = String::from(
        "epoch,step,learning_rate,train_loss,validation_loss,validation_accuracy,\
         validation_macro_f1,validation_fpr,validation_missed,validation_latency,seconds\n",
    );
    for row in rows {
        let Row { epoch, step, learning_rate, train_loss, seconds, .. } = row;
        let figures = [
            row.validation_loss,
            row.validation_accuracy,
            row.validation_macro_f1,
            row.validation_fpr,
            row.validation_missed,
        ];
        let figures = figures.map(|figure| format!("{:.4}", figure.unwrap_or(f64::NAN))).join(",");
        let latency = row.validation_latency.unwrap_or(f64::NAN);
        text += &format!(
            "{epoch},{step},{learning_rate:.3e},{train_loss:.4},{figures},{latency:.1},{seconds:.1}\n"
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
        let (new, place) = (out.join(NEW), out.join(FOLDER));
        let failed = || format!("cannot write {}", place.display());
        remove(&new).with_context(failed)?;
        fs::create_dir_all(&new).with_context(failed)?;
        self.weights.write(&new.join(WEIGHTS))?;
        self.average.write(&new.join(AVERAGE))?;
        optimizer.save(new.join(OPTIMIZER)).map_err(|e| anyhow!("{e}")).with_context(failed)?;
        let state = State { rows: self.rows.clone(), recipe: self.recipe.clone() };
        output::write(&new.join(STATE), serde_json::to_string_pretty(&state)?.as_bytes())?;
        swap(out)
    }

    /// Read the folder's checkpoint back; refuses one of a run with another recipe.
    pub fn read(
        out: &Path,
        recipe: &serde_json::Value,
        optimizer: ModuleOptimizer,
    ) -> Result<(Self, ModuleOptimizer)> {
        let place = out.join(FOLDER);
        if out.join(NEW).join(STATE).exists() {
            // The run was stopped before this.
            swap(out)?;
        }
        let path = place.join(STATE);
        let text = output::read(&path).context("no run to resume")?;
        let State { rows, recipe: started } =
            serde_json::from_slice(&text).with_context(|| format!("cannot use {}", path.display()))?;
        ensure!(
            started == *recipe,
            "{}: the run was started with {started}, now asked for {recipe}",
            path.display()
        );
        let weights = Weights::read(&place.join(WEIGHTS))?;
        let average = Weights::read(&place.join(AVERAGE))?;
        let path = place.join(OPTIMIZER);
        let optimizer = optimizer
            .load(&path)
            .map_err(|e| anyhow!("{e}"))
            .with_context(|| format!("cannot use {}", path.display()))?;
        Ok((Self { weights, average, rows, recipe: started }, optimizer))
    }
}

fn remove(folder: &Path) -> std::io::Result<()> {
    if folder.exists() { fs::remove_dir_all(folder) } else { Ok(()) }
}

/// Put what is written in the place of the checkpoint before.
fn swap(out: &Path) -> Result<()> {
    let place = out.join(FOLDER);
    let swapped = remove(&place).and_then(|()| fs::rename(out.join(NEW), &place));
    swapped.with_context(|| format!("cannot write {}", place.display()))
}
