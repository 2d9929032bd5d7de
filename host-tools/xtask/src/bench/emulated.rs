//! The benchmark program on the emulated board: exact numbers of instructions.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use slipsense::net::Model;
use slipsense_qemu::INPUT_FILE;
use slipsense_qemu::measured::{
    COMPRESSION_FILE, FrameCost, Line, MEASURED_FILE, Part, TRACE_FILE, WARM_UP_FRAMES,
};
use slipsense_recording::model_file::cost;
use tempfile::TempDir;

use super::inputs::Input;
use super::trace::{Recorder, Trace};
use crate::elf::Image;
use crate::qemu::machine::{Machine, write_input};
use crate::qemu::{self, frames::Frames};

const PROGRAM: &str = "slipsense-qemu-bench";
const TIMEOUT: Duration = Duration::from_secs(900);
/// No frames: kernels only.
const NOTHING: (Input, usize, usize) = (Input::Idle, 1, 0);

/// One kernel.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Kernel {
    pub name: String,
    pub macs: u32,
    pub instructions: u32,
}

/// Median and largest of the frames, instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Spread {
    pub median: u32,
    pub worst: u32,
}

/// A part of the path.
#[derive(Clone, Debug, Serialize)]
pub struct PartCost {
    pub name: &'static str,
    pub macs: usize,
    #[serde(flatten)]
    pub instructions: Spread,
}

/// The path with one kind of input.
#[derive(Clone, Debug, Serialize)]
pub struct PathCost {
    pub input: &'static str,
    pub sensors: usize,
    pub frames: usize,
    pub macs: usize,
    /// From samples to CAN frames.
    #[serde(flatten)]
    pub instructions: Spread,
    /// Measured through a network that is watched; what is left goes to `rest`.
    pub parts: Vec<PartCost>,
    /// Median of what no part accounts for: health, decision, copies, and the difference that watching makes.
    pub rest: i64,
}

/// Everything that the program measured.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Emulated {
    /// Instructions of a loop by its code, and as measured: equal, or nothing here is to be believed.
    pub loop_expected: u32,
    pub loop_measured: u32,
    pub kernels: Vec<Kernel>,
    pub paths: Vec<PathCost>,
    /// Bytes of the types on the microcontroller.
    pub sizes: BTreeMap<String, u32>,
}

/// Measure the kernels and, if `frames` is not 0, the path over so many frames.
pub fn measure(model: &[u8], frames: usize) -> Result<Emulated> {
    let machine = Machine::build(PROGRAM, &[])?;
    let parsed = Model::parse(model).context("the model to measure")?;
    let mut all = Emulated::default();
    let nothing = [NOTHING];
    let path: Vec<_> = (1..=slipsense::params::MAX_SENSORS)
        .flat_map(|sensors| Input::ALL.map(|input| (input, sensors, WARM_UP_FRAMES + frames)))
        .collect();
    for &(input, sensors, count) in if frames == 0 { &nothing[..] } else { &path } {
        if count > 0 {
            eprintln!("{sensors} sensors, {}: {count} frames on the emulated Cortex-M7", input.name());
        }
        let text = run(&machine, &input.frames(sensors, count)?, model)?;
        let (one, costs) = parse(&text)?;
        ensure!(costs.len() == count, "the emulated program measured {} frames of {count}", costs.len());
        ensure!(
            all.kernels.is_empty() || all.kernels == one.kernels,
            "two runs of the emulator disagree about a kernel: is it started with -icount?"
        );
        let paths = std::mem::take(&mut all.paths);
        all = Emulated { paths, ..one };
        if let Some(costs) = costs.get(WARM_UP_FRAMES..).filter(|costs| !costs.is_empty()) {
            all.paths.push(path_cost(input, sensors, &parsed, costs));
        }
    }
    Ok(all)
}

/// Bytes and instructions of every sensor's frame compressed, on the emulated core.
pub fn compressed(model: &[u8], frames: &Frames) -> Result<Vec<(u32, u32)>> {
    let machine = Machine::build(PROGRAM, &[])?;
    let dir = folder(frames, model)?;
    fs::write(dir.path().join(COMPRESSION_FILE), "").context(COMPRESSION_FILE)?;
    machine.run(dir.path(), TIMEOUT)?;
    let (mut checked, mut costs) = (false, Vec::new());
    for line in output(dir.path())?.lines() {
        match Line::parse(line).with_context(|| format!("the emulated program wrote `{line}`"))? {
            Line::Check { expected, measured } => checked = expected == measured && expected > 0,
            Line::Compressed { bytes, instructions } => costs.push((bytes, instructions)),
            _ => bail!("the emulated program wrote `{line}` where it compresses"),
        }
    }
    ensure!(checked, "the counter of the emulated program cannot be believed");
    Ok(costs)
}

/// Every instruction of the last of these frames' `Pipeline::step`, and how many it was measured to be.
pub fn trace(model: &[u8], input: Input, sensors: usize) -> Result<(Trace, u32)> {
    let machine = Machine::build(PROGRAM, &[])?;
    let count = WARM_UP_FRAMES + 1;
    let dir = folder(&input.frames(sensors, count)?, model)?;
    fs::write(dir.path().join(TRACE_FILE), "").context(TRACE_FILE)?;
    let mut recorder = Recorder::new(Image::read(&machine.program)?)?;
    qemu::trace::trace(&machine, dir.path(), |pc| recorder.see(pc))?;
    let (_, costs) = parse(&output(dir.path())?)?;
    let step = costs.last().context("the emulated program measured no frame")?.step;
    Ok((recorder.trace()?, step))
}

fn run(machine: &Machine, frames: &Frames, model: &[u8]) -> Result<String> {
    let dir = folder(frames, model)?;
    machine.run(dir.path(), TIMEOUT)?;
    output(dir.path())
}

/// With the files that the program reads.
fn folder(frames: &Frames, model: &[u8]) -> Result<TempDir> {
    let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
    write_input(&dir.path().join(INPUT_FILE), frames, model).context(INPUT_FILE)?;
    Ok(dir)
}

fn output(dir: &Path) -> Result<String> {
    fs::read_to_string(dir.join(MEASURED_FILE)).context("the emulated program wrote no output")
}

/// All but the paths, and the cost of each frame.
fn parse(text: &str) -> Result<(Emulated, Vec<FrameCost>)> {
    let mut all = Emulated::default();
    let mut frames = Vec::new();
    for line in text.lines() {
        match Line::parse(line).with_context(|| format!("the emulated program wrote `{line}`"))? {
            Line::Check { expected, measured } => {
                (all.loop_expected, all.loop_measured) = (expected, measured)
            }
            Line::Kernel { macs, instructions, name } => {
                all.kernels.push(Kernel { name: name.to_owned(), macs, instructions });
            }
            Line::Frame(cost) => frames.push(cost),
            Line::Compressed { .. } => bail!("the emulated program compressed, and was not asked to"),
            Line::Size { bytes, name } => _ = all.sizes.insert(name.to_owned(), bytes),
        }
    }
    if all.loop_expected == 0 || all.loop_expected != all.loop_measured {
        bail!(
            "a loop of {} instructions was measured to take {}: the counter cannot be believed",
            all.loop_expected,
            all.loop_measured
        );
    }
    Ok((all, frames))
}

fn path_cost(input: Input, sensors: usize, model: &Model<'_>, frames: &[FrameCost]) -> PathCost {
    let spread = |cost: &dyn Fn(&FrameCost) -> u32| Spread::of(frames.iter().map(cost).collect());
    let layers = cost::layers(model);
    let parts: Vec<_> = Part::ALL
        .iter()
        .map(|&part| PartCost {
            name: part.name(),
            macs: layers
                .iter()
                .filter(|layer| part_of(layer.name) == Some(part))
                .map(|layer| layer.macs_per_frame(sensors))
                .sum(),
            instructions: spread(&|frame| frame.parts[part as usize]),
        })
        .collect();
    let instructions = spread(&|frame| frame.step + frame.wire);
    let known: i64 = parts.iter().map(|part| i64::from(part.instructions.median)).sum();
    PathCost {
        input: input.name(),
        sensors,
        frames: frames.len(),
        macs: cost::macs_per_frame(&layers, sensors),
        instructions,
        parts,
        rest: i64::from(instructions.median) - known,
    }
}

/// Where a layer of the model file is computed.
fn part_of(layer: &str) -> Option<Part> {
    Some(match layer.split_once('.') {
        Some(("piezo", "conv1")) => Part::Conv1,
        Some(("piezo", "conv2")) => Part::Conv2,
        Some(("piezo", "conv3")) => Part::Conv3,
        Some(("piezo", _)) => Part::PiezoDense,
        Some(("xl", _)) => Part::XlEncoder,
        Some(("cross_piezo" | "cross_xl", _)) => Part::CrossAttention,
        Some(("temporal", _)) => Part::TemporalAttention,
        None if layer == "head" => Part::Head,
        _ => return None,
    })
}

impl Spread {
    fn of(mut values: Vec<u32>) -> Self {
        values.sort_unstable();
        let median = values.get(values.len() / 2).copied().unwrap_or_default();
        Self { median, worst: values.last().copied().unwrap_or_default() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use slipsense::net::format::Dims;
    use slipsense_qemu::measured::PARTS;
    use slipsense_recording::model_file::random_model;

    #[test]
    fn lines_of_the_program_are_read_back() {
        let mut parts = [0; PARTS];
        parts[3] = 77;
        let cost = FrameCost { step: 5, wire: 6, parts };
        let lines = [
            Line::Check { expected: 10, measured: 10 },
            Line::Kernel { macs: 3, instructions: 4, name: "conv 3x3 8x8x16->32, ReLU" },
            Line::Frame(cost),
            Line::Size { bytes: 9, name: "Pipeline" },
        ];
        let text: String = lines.iter().map(ToString::to_string).collect();
        let (all, frames) = parse(&text).unwrap();
        assert_eq!(frames, [cost]);
        assert_eq!(all.sizes["Pipeline"], 9);
        let name = "conv 3x3 8x8x16->32, ReLU".to_owned();
        assert_eq!(all.kernels, [Kernel { name, macs: 3, instructions: 4 }]);
    }

    #[test]
    fn a_counter_that_is_off_is_refused() {
        let error = parse("check 200000 200001\n").unwrap_err().to_string();
        assert!(error.contains("200001"), "{error}");
        assert!(parse("").is_err(), "without the check nothing is believed");
    }

    #[test]
    fn every_layer_belongs_to_a_part() {
        let dims = Dims {
            conv_channels: [8, 16, 32],
            embed: 64,
            xl_kernel: 8,
            xl_channels: 64,
            heads: 4,
            window: 60,
        };
        let file = random_model(dims, 1).to_bytes().unwrap();
        let model = Model::parse(&file).unwrap();
        for layer in cost::layers(&model) {
            assert!(part_of(layer.name).is_some(), "{}", layer.name);
        }
    }

    #[test]
    fn median_and_worst() {
        assert_eq!(Spread::of(vec![9, 1, 5]), Spread { median: 5, worst: 9 });
        assert_eq!(Spread::of(vec![]), Spread::default());
    }
}
