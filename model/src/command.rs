//! `slipsense quantize`: calibrate, quantize, write, and say what both networks reach.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde::Deserialize;
use serde_json::{Value, json};
use slipsense::net::{Model, SensorFeatures};
use slipsense_recording::hex;
use slipsense_recording::model_file::SCALES_KEY;

use crate::data::{Features, Source};
use crate::evaluate::{Comparison, Figures, compare};
use crate::folder::{ObjectUses, Use};
use crate::progress::progress;
use crate::trace::Ranges;
use crate::tract::{Graphs, TractNetwork};
use crate::train::RECORD;
use crate::weights::Weights;
use crate::{
    export, output,
    quantize::{activation_scales, quantize},
};

/// Training episodes on which ranges are measured, where nobody says how many.
pub(crate) const CALIBRATION_EPISODES: usize = 24;

/// Turn trained weights into the model file that host and microcontroller run.
///
/// Ranges are measured on training episodes; the model is refused if any accumulator could overflow.
/// Then the integer pipeline and the float network run over validation episodes, whose objects training
/// never saw, and a table says what they reach. Test splits are for `slipsense eval`.
#[derive(Args, Clone, Debug)]
pub struct QuantizeArgs {
    /// Weights from `slipsense train`.
    #[arg(long, value_name = "FILE")]
    pub weights: PathBuf,
    /// Model file to write.
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Calibrate and validate on the labelled .npz episodes of this folder instead of generated ones;
    /// objects are for what they were for in training.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Seed of the calibration episodes. The validation episodes are always the same.
    #[arg(long, value_name = "K", default_value_t = 1)]
    pub seed: u64,
    /// Training episodes on which ranges are measured.
    #[arg(long, value_name = "N", default_value_t = CALIBRATION_EPISODES)]
    pub calibration_episodes: usize,
    /// Validation episodes for the table.
    #[arg(long, value_name = "N", default_value_t = 40)]
    pub val_episodes: usize,
    /// Also write all figures, and what the model was made from, to this file.
    #[arg(long, value_name = "FILE.json")]
    pub report: Option<PathBuf>,
}

pub fn run_quantize(args: &QuantizeArgs) -> Result<()> {
    ensure!(args.calibration_episodes > 0, "--calibration-episodes must be at least 1");
    ensure!(args.val_episodes > 0, "--val-episodes must be at least 1");
    let weights = Weights::read(&args.weights)?;
    let training: Option<Value> = output::read_json(&args.weights.with_file_name(RECORD))?;
    // What training left out is left out here too.
    let uses = match training.as_ref().and_then(|training| training["recipe"].get("objects")) {
        Some(objects) => ObjectUses::deserialize(objects).context("train.json: recipe.objects")?,
        None => ObjectUses::default(),
    };
    let source = Source::new(args.data.as_deref(), uses, args.seed);

    let bar = progress("calibrate", args.calibration_episodes as u64);
    let graphs = Graphs::traced(&weights)?;
    let seen = source.map(Use::Train, args.calibration_episodes, &bar, |episode| {
        measure(&graphs, &Features::from_episode(&episode)?)
    })?;
    bar.finish_and_clear();
    let mut ranges = Ranges::default();
    seen.iter().for_each(|one| ranges.merge(one));

    let provenance = json!({
        "data": source.describe(),
        "synthetic": args.data.is_none(),
        "weights_sha256": output::sha256_hex(&weights.to_bytes()?),
        "calibration_episodes": seen.len(),
        "training": training.as_ref().map(|t| &t["recipe"]),
        SCALES_KEY: activation_scales(&weights.dims, &ranges)?,
    });
    let file = quantize(&weights, &ranges, &provenance.to_string())?;
    let bytes = export::to_bytes(&file)?;
    let model = Model::parse(&bytes)?;

    let float = Graphs::new(&weights)?;
    let bar = progress("validate", args.val_episodes as u64);
    let results =
        source.map(Use::Validation, args.val_episodes, &bar, |episode| compare(model, &float, &episode))?;
    bar.finish_and_clear();
    let episodes = results.len();
    let mut total = Comparison::default();
    results.into_iter().for_each(|one| total.add(one));

    output::write(&args.out, &bytes).context("the model was not written")?;
    if let Some(path) = &args.report {
        let validation = match args.data {
            None => "synthetic, splits val and val_anywhere and disturbances in turn".to_owned(),
            Some(_) => source.describe(),
        };
        let report = json!({
            "command": command_line(args),
            "model_bytes": bytes.len(),
            "model_sha256": output::sha256_hex(&bytes),
            "model_hash": hex(&model.hash),
            "weights_sha256": provenance["weights_sha256"],
            "calibration_episodes": seen.len(),
            "training": training,
            "validation": {
                "data": validation,
                "objects": "never used for training or calibration",
                "episodes": episodes,
                "integer": total.integer.figures(),
                "float": total.float.figures(),
                "always_slip_when_touched": total.always_slip.figures(),
                "integer_confusion_truth_by_prediction": total.integer.classes.confusion,
                "same_class_share": total.agreement(),
                "logit_snr_db": total.logit_snr_db(),
            },
        });
        output::write_json(path, &report)?;
    }
    let kind = if args.data.is_none() { "synthetic" } else { "the folder's" };
    println!("{} episodes ({kind}) for validation:\n", episodes);
    print!("{}", table(&total));
    println!("\n{}: {} bytes", args.out.display(), bytes.len());
    Ok(())
}

/// Largest magnitudes of all activations over one episode: with all sensors, and with each alone.
pub(crate) fn measure(graphs: &Graphs, features: &Features) -> Result<Ranges> {
    let mut ranges = Ranges::default();
    let alone = (0..features.sensors).filter(|_| features.sensors > 1).map(Some);
    for only in std::iter::once(None).chain(alone) {
        let mut network = TractNetwork::new(graphs, features.sensors)?;
        for frame in 0..features.frames() {
            let scans = features.scans(frame);
            let seen = scans.iter().enumerate().map(|(sensor, scan)| match only {
                Some(only) if only != sensor => SensorFeatures::default(),
                _ => SensorFeatures { piezo: Some(scan), xl: Some(features.reading(frame, sensor).xl) },
            });
            network.step(&seen.collect::<Vec<_>>())?;
            ranges.merge(&Ranges::of(&network.trace));
            network.trace.clear();
        }
    }
    Ok(ranges)
}

/// The command that makes this report again.
fn command_line(args: &QuantizeArgs) -> String {
    let mut text =
        format!("slipsense quantize --weights {} --out {}", args.weights.display(), args.out.display());
    if let Some(data) = &args.data {
        text += &format!(" --data {}", data.display());
    }
    text + &format!(
        " --seed {} --calibration-episodes {} --val-episodes {}",
        args.seed, args.calibration_episodes, args.val_episodes
    )
}

type Show = fn(&Figures) -> String;

fn table(total: &Comparison) -> String {
    let columns = [total.integer.figures(), total.float.figures(), total.always_slip.figures()];
    fn percent(x: Option<f64>) -> String {
        x.map_or("–".to_owned(), |x| format!("{:.2} %", 100.0 * x))
    }
    let rows: [(&str, Show); 9] = [
        ("accuracy, 3 classes", |f| percent(f.accuracy)),
        ("macro F1", |f| percent(f.macro_f1)),
        ("slip F1", |f| percent(f.slip_f1)),
        ("false slip frames / non-slip", |f| percent(f.fpr_of_non_slip)),
        ("events flagged / all", |f| format!("{} / {}", f.hits, f.events)),
        ("flagged up to 50 ms early", |f| f.early.to_string()),
        ("missed", |f| f.missed.to_string()),
        ("median delay, misses infinite", |f| {
            f.median_latency_frames.map_or("infinite".into(), |m| format!("{m} frames"))
        }),
        ("false alarms (per hour)", |f| {
            format!("{} ({:.0})", f.false_alarms, f.false_alarms_per_hour.unwrap_or(f64::NAN))
        }),
    ];
    let mut text = format!("{:30} {:>14} {:>14} {:>14}\n", "", "integer", "float", "always slip");
    for (name, show) in &rows {
        let [integer, float, always] = columns.each_ref().map(show);
        text += &format!("{name:30} {integer:>14} {float:>14} {always:>14}\n");
    }
    let agreement = percent(total.agreement());
    text + &format!(
        "\ninteger and float give the same class in {agreement} of {} frames; logits {:.1} dB above their error\n",
        columns[0].frames,
        total.logit_snr_db()
    )
}
