//! Estimates of cycles: one step of the pipeline, all its instructions in order, and the loops in which a network
//! spends its time.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use slipsense::params::MAX_SENSORS;

use super::emulated;
use super::inputs::Input;
use super::loops::{Loop, innermost};
use super::mca::{self, Cycles};
use crate::elf::{Code, Image};

/// A loop is taken to turn so often.
const TURNS: u64 = 100;
/// Functions that may hold a loop of the network; those in assembly have plain names.
const KERNELS: [&str; 3] = ["slipsense_", "slipsense::net::", "pipeline::Pipeline>::step"];
/// The convolutions among them.
const CONVOLUTION: &str = "slipsense_conv_";
/// What a step is estimated with.
const INPUT: Input = Input::Typical;

/// What one step spends in a function, calls left out.
#[derive(Clone, Debug, Serialize)]
pub struct FunctionEstimate {
    pub name: String,
    pub instructions: usize,
    pub cycles: u64,
}

/// One `Pipeline::step` with full windows.
#[derive(Clone, Debug, Serialize)]
pub struct StepEstimate {
    pub input: &'static str,
    pub sensors: usize,
    /// Exact.
    pub instructions: u32,
    /// Estimated, over the instructions that the emulator did.
    pub cycles: u64,
    /// Instructions that the model does not know.
    pub unknown: usize,
    /// Most cycles first.
    pub functions: Vec<FunctionEstimate>,
}

/// One loop.
#[derive(Clone, Debug, Serialize)]
pub struct LoopEstimate {
    pub function: String,
    pub address: u64,
    pub instructions: usize,
    /// Multiply-accumulates that one turn does.
    pub products: u32,
    /// Multiply-accumulates of the layer that they stand for.
    pub macs: u32,
    /// Of one turn, estimated.
    pub cycles: f64,
}

/// All estimates, and whose model it is.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    pub model: String,
    pub steps: Vec<StepEstimate>,
    pub loops: Vec<LoopEstimate>,
}

/// Estimate steps with this model, and the loops of the network in the firmware.
pub fn estimate(firmware: &Path, model: &[u8]) -> Result<Estimate> {
    Ok(Estimate {
        model: mca::model()?,
        steps: (1..=MAX_SENSORS).map(|sensors| step(model, sensors)).collect::<Result<_>>()?,
        loops: loops(firmware)?,
    })
}

fn step(model: &[u8], sensors: usize) -> Result<StepEstimate> {
    eprintln!("{sensors} sensors, {}: tracing a step on the emulated Cortex-M7", INPUT.name());
    let (trace, measured) = emulated::trace(model, INPUT, sensors)?;
    let mut estimate = StepEstimate {
        input: INPUT.name(),
        sensors,
        instructions: measured,
        cycles: 0,
        unknown: 0,
        functions: Vec::new(),
    };
    for (name, instructions) in trace {
        let Cycles { cycles, unknown } = mca::cycles(&instructions, 1).with_context(|| name.clone())?;
        estimate.cycles += cycles;
        estimate.unknown += unknown;
        estimate.functions.push(FunctionEstimate { name, instructions: instructions.len(), cycles });
    }
    estimate.functions.sort_by_key(|function| std::cmp::Reverse(function.cycles));
    let traced: usize = estimate.functions.iter().map(|function| function.instructions).sum();
    // Handing over the result is measured, and lies outside the trace.
    ensure!(
        traced.abs_diff(measured as usize) * 100 <= measured as usize,
        "the trace of a step holds {traced} instructions, it was measured to take {measured}"
    );
    Ok(estimate)
}

/// What is gained by [`slipsense::simd::portable::conv_relu_pool`]'s form of a convolution: two products for three.
fn macs(function: &str, products: u32) -> u32 {
    if function.starts_with(CONVOLUTION) { products * 3 / 2 } else { products }
}

fn loops(firmware: &Path) -> Result<Vec<LoopEstimate>> {
    let image = Image::read(firmware)?;
    let code = Code::new()?;
    let mut loops = Vec::new();
    for function in &image.functions {
        if !KERNELS.iter().any(|kernel| function.name.contains(kernel)) {
            continue;
        }
        for Loop { address, body, products } in innermost(&code.of(&image, function)?) {
            let turns = mca::cycles(&body, TURNS);
            let turns = turns.with_context(|| format!("{} at {address:#x}", function.name))?;
            loops.push(LoopEstimate {
                function: function.name.clone(),
                address,
                instructions: body.len(),
                products,
                macs: macs(&function.name, products),
                cycles: turns.cycles as f64 / TURNS as f64,
            });
        }
    }
    ensure!(!loops.is_empty(), "{}: no loop of the network found", firmware.display());
    Ok(loops)
}
