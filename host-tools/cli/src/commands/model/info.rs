//! `slipsense model info`: layers, cost, head-room, and how the model was made.

use std::fmt::Write as _;
use std::path::PathBuf;

use anyhow::Result;
use indicatif::HumanCount;
use serde::Serialize;
use slipsense::net::Model;
use slipsense::net::format::Dims;
use slipsense::params::MAX_SENSORS;
use slipsense::params::limits::MODEL_BYTES;
use slipsense::pipeline::{PIPELINE_BYTES_MAX, Pipeline};
use slipsense::settings::model_numbers;
use slipsense_recording::model_file::SCALES_KEY;
use slipsense_recording::model_file::cost::{
    LayerCost, MACS_MAX_ONE_SENSOR, MACS_MAX_THREE_SENSORS, layers, macs_per_frame,
};

use crate::bundled;
use crate::commands::Print;
use crate::summary::{ModelInfo, OperatingPointInfo};

/// Say what is in a model file: layers, cost, accumulator head-room, how it was made
///
/// Multiply-accumulates (MAC) are counted at full contact: every taxel, attention over its full window, scores
/// and context included; norms, softmax, requantization and the front end are not counted.
#[derive(clap::Args)]
#[command(after_help = "\
Columns:
  shape      outputs × inputs of one output; scores: heads × lags
  bytes      in the file
  MAC/frame  with one sensor and with three
  unit       real value of one integer unit of the layer's output, as a power of two
  head-room  bits of the 32-bit accumulator that no input can reach: 31 − log2(largest possible sum)

Examples:
  slipsense model info
  slipsense model info other.slipnet
  slipsense model info --json | jq '.layers[] | select(.head_room_bits < 2)'")]
pub struct Args {
    /// Model file; the bundled one if not given
    #[arg(value_name = "MODEL")]
    model: Option<PathBuf>,
    #[command(flatten)]
    print: Print,
}

/// With a comma after every third digit from the right.
fn thousands(number: usize) -> String {
    HumanCount(number as u64).to_string()
}

#[derive(Serialize)]
struct Info {
    model: ModelInfo,
    /// For the setting `slipsense.model.expected`.
    model_expected: [u32; 2],
    /// By the names of the file's header.
    sizes: Vec<Size>,
    layers: Vec<LayerInfo>,
    totals: Vec<Total>,
}

#[derive(Serialize)]
struct Size {
    name: &'static str,
    value: usize,
}

#[derive(Serialize)]
struct LayerInfo {
    name: &'static str,
    shape: [usize; 2],
    bytes: usize,
    macs_one_sensor: usize,
    macs_three_sensors: usize,
    /// Real value of one unit of the output; `null` where the provenance does not say.
    unit: Option<f64>,
    accumulator_bound: i64,
    head_room_bits: f64,
}

/// A sum beside what it may be.
#[derive(Serialize)]
struct Total {
    name: &'static str,
    value: usize,
    at_most: usize,
    fits: bool,
    note: &'static str,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let source = bundled::model(self.model.as_deref())?;
        let info = Info::new(&source.parse()?, &source.name, source.bytes.len());
        self.print.show(&info, || info.text())
    }
}

impl Info {
    fn new(model: &Model<'_>, name: &str, file_bytes: usize) -> Self {
        let facts = ModelInfo::new(model, name);
        let layers = layers(model);
        let unit = |layer: &LayerCost| facts.provenance.get(SCALES_KEY)?.get(layer.gives?)?.as_f64();
        let rows = layers.iter().map(|layer| LayerInfo {
            name: layer.name,
            shape: layer.shape,
            bytes: layer.bytes,
            macs_one_sensor: layer.macs_per_frame(1),
            macs_three_sensors: layer.macs_per_frame(MAX_SENSORS),
            unit: unit(layer),
            accumulator_bound: layer.bound,
            head_room_bits: layer.head_room_bits(),
        });
        let rows = rows.collect();
        let sizes = Dims::FIELDS.into_iter().zip(model.dims.to_fields());
        let total = |name, value, at_most, note| Total { name, value, at_most, fits: value <= at_most, note };
        Self {
            model: facts,
            model_expected: model_numbers(&model.hash),
            sizes: sizes.map(|(name, value)| Size { name, value }).collect(),
            layers: rows,
            totals: vec![
                total("MAC per frame, 1 sensor", macs_per_frame(&layers, 1), MACS_MAX_ONE_SENSOR, ""),
                total(
                    "MAC per frame, 3 sensors",
                    macs_per_frame(&layers, MAX_SENSORS),
                    MACS_MAX_THREE_SENSORS,
                    "",
                ),
                total("bytes of the file", file_bytes, MODEL_BYTES, ""),
                total(
                    "bytes of RAM, 3 sensors",
                    size_of::<Pipeline<'static>>(),
                    PIPELINE_BYTES_MAX,
                    "the pipeline's state on this 64-bit host; less on a 32-bit microcontroller, whose build \
                     checks the same limit",
                ),
            ],
        }
    }

    fn text(&self) -> String {
        let [first, second] = self.model_expected;
        let mut text = format!(
            "model {}\nhash  {}\nfor the setting slipsense.model.expected: {first}, {second}\n\n",
            self.model.name, self.model.hash
        );
        for size in &self.sizes {
            let _ = writeln!(text, "  {:24} {:>5}", size.name, size.value);
        }
        let OperatingPointInfo { threshold_nat, k, n } = self.model.operating_point;
        let _ = writeln!(text, "  {:24} {k} of {n} frames over {threshold_nat:.3} nat", "slip flag");
        text += &self.layer_table();
        for Total { name, value, at_most, fits, note } in &self.totals {
            let verdict = if *fits { "fits" } else { "TOO MUCH" };
            let [value, at_most] = [*value, *at_most].map(thousands);
            let _ = writeln!(text, "  {name:24} {value:>11}   at most {at_most:>11}   {verdict}");
            if !note.is_empty() {
                let _ = writeln!(text, "    ({note})");
            }
        }
        let mut provenance = self.model.provenance.clone();
        if let Some(fields) = provenance.as_object_mut() {
            // The column of units has shown them.
            fields.remove(SCALES_KEY);
        }
        text + &format!("\nmade from\n{provenance:#}\n")
    }

    fn layer_table(&self) -> String {
        let mut text = format!(
            "\n  {:18} {:>9} {:>8} {:>11} {:>11} {:>8} {:>10}\n",
            "layer", "shape", "bytes", "MAC/frame 1", "3 sensors", "unit", "head-room"
        );
        for layer in &self.layers {
            let [outputs, inputs] = layer.shape;
            let _ = writeln!(
                text,
                "  {:18} {:>9} {:>8} {:>11} {:>11} {:>8} {:>5.1} bits",
                layer.name,
                format!("{outputs} × {inputs}"),
                thousands(layer.bytes),
                thousands(layer.macs_one_sensor),
                thousands(layer.macs_three_sensors),
                layer.unit.map_or("–".to_owned(), |unit| format!("2^{:.1}", unit.log2())),
                layer.head_room_bits,
            );
        }
        text + "\n"
    }
}
