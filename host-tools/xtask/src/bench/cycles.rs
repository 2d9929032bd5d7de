//! An estimate of cycles: the hot loops of the firmware through LLVM's model of the Cortex-M7.
//!
//! The model knows both pipelines and the latencies, with memory that never waits. It does not know the caches,
//! nor what a wrong guess of a branch costs: an estimate, no measurement.

use std::io::Write;
use std::path::Path;
use std::process::Stdio;

use anyhow::{Context, Result, ensure};
use serde::Serialize;
use serde_json::Value;

use super::loops::{Loop, innermost};
use crate::elf::{Code, Image, Instruction};
use crate::process::{answer, apt_install, command, find};

const PROGRAM: &str = "llvm-mca";
const PACKAGE: &str = "llvm";
const TURNS: u64 = 100;
/// Functions that may hold a loop of the network.
const KERNELS: [&str; 2] = ["slipsense::net::", FRAME_PATH];
const FRAME_PATH: &str = "pipeline::Pipeline>::step";

/// One loop.
#[derive(Clone, Debug, Serialize)]
pub struct LoopEstimate {
    pub function: String,
    pub address: u64,
    pub instructions: usize,
    pub macs: u32,
    /// Of one turn, estimated.
    pub cycles: f64,
}

/// All loops, and whose model it is.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    pub model: String,
    pub loops: Vec<LoopEstimate>,
}

/// Estimate the loops of the network in this program.
pub fn estimate(elf: &Path) -> Result<Estimate> {
    if find(PROGRAM).is_none() {
        apt_install(&[PACKAGE], "estimating cycles with llvm-mca")?;
    }
    let version = answer(command(PROGRAM).arg("--version")).context("llvm-mca does not say its version")?;
    let version = version.lines().find(|line| line.contains("version")).unwrap_or_default().trim();
    let image = Image::read(elf)?;
    let code = Code::new()?;
    let mut loops = Vec::new();
    for function in &image.functions {
        if !KERNELS.iter().any(|kernel| function.name.contains(kernel)) {
            continue;
        }
        for Loop { address, body, macs } in innermost(&code.of(&image, function)?) {
            let cycles = cycles(&body).with_context(|| format!("{} at {address:#x}", function.name))?;
            let instructions = body.len();
            loops.push(LoopEstimate { function: function.name.clone(), address, instructions, macs, cycles });
        }
    }
    ensure!(!loops.is_empty(), "{}: no loop of the network found", elf.display());
    Ok(Estimate { model: format!("llvm-mca -mcpu=cortex-m7, {version}"), loops })
}

/// Of one turn.
fn cycles(body: &[Instruction]) -> Result<f64> {
    let mut mca = command(PROGRAM)
        .args(["-mtriple=thumbv7em-none-eabihf", "-mcpu=cortex-m7", "-json"])
        .arg(format!("-iterations={TURNS}"))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start llvm-mca")?;
    let text = assembly(body);
    // Small enough for a pipe, so nobody waits for nobody.
    mca.stdin.take().context("llvm-mca takes no input")?.write_all(text.as_bytes())?;
    let output = mca.wait_with_output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "llvm-mca refused the loop: {errors}");
    let answer: Value = serde_json::from_slice(&output.stdout).context("llvm-mca gave no JSON")?;
    Ok(total_cycles(&answer).context("llvm-mca gave no number of cycles")? as f64 / TURNS as f64)
}

fn total_cycles(answer: &Value) -> Option<u64> {
    answer["CodeRegions"][0]["SummaryView"]["TotalCycles"].as_u64()
}

/// For the assembler: branch targets become labels, because a loop stands alone. The model has no `it`: it
/// becomes a `nop`, and what it governs is done always, which takes as long.
fn assembly(body: &[Instruction]) -> String {
    let mut text = String::from(".syntax unified\n.thumb\nturn:\n");
    let mut governed = 0;
    for instruction in body {
        let Instruction { mnemonic, operands, .. } = instruction;
        let governs = instruction.governs();
        let mnemonic = match governed {
            0 if governs > 0 => "nop".to_owned(),
            0 => mnemonic.clone(),
            _ => always(mnemonic),
        };
        governed = if governs > 0 { governs } else { governed.saturating_sub(1) };
        match (instruction.direct_target(), operands.rsplit_once('#')) {
            (Some(_), Some((before, _))) => text += &format!("{mnemonic} {before}turn\n"),
            _ if mnemonic == "nop" => text += "nop\n",
            _ => text += &format!("{mnemonic} {operands}\n"),
        }
    }
    text
}

/// `movlo.w` to `mov.w`.
fn always(mnemonic: &str) -> String {
    let (plain, width) = mnemonic.split_once('.').map_or((mnemonic, ""), |(plain, width)| (plain, width));
    let plain = plain.get(..plain.len().saturating_sub(2)).unwrap_or_default();
    if width.is_empty() { plain.to_owned() } else { format!("{plain}.{width}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn branches_lead_to_the_loop() {
        let line = |mnemonic: &str, operands: &str| Instruction {
            address: 0,
            bytes: 4,
            mnemonic: mnemonic.to_owned(),
            operands: operands.to_owned(),
        };
        let body = [line("smlad", "r0, r1, r2, r0"), line("cbz", "r3, #0x90"), line("bne.w", "#0x80")];
        let text = assembly(&body);
        assert!(text.ends_with("turn:\nsmlad r0, r1, r2, r0\ncbz r3, turn\nbne.w turn\n"), "{text}");
    }

    #[test]
    fn what_an_it_governs_is_done_always() {
        let line = |mnemonic: &str, operands: &str| Instruction {
            address: 0,
            bytes: 2,
            mnemonic: mnemonic.to_owned(),
            operands: operands.to_owned(),
        };
        let body = [
            line("ite", "lo"),
            line("movlo", "r0, r1"),
            line("movhs.w", "r0, r2"),
            line("adds", "r0, r0, r1"),
        ];
        let text = assembly(&body);
        assert!(text.ends_with("turn:\nnop\nmov r0, r1\nmov.w r0, r2\nadds r0, r0, r1\n"), "{text}");
    }

    #[test]
    fn cycles_are_read_from_the_summary() {
        let answer = serde_json::json!({"CodeRegions": [{"SummaryView": {"TotalCycles": 512}}]});
        assert_eq!(total_cycles(&answer), Some(512));
        assert_eq!(total_cycles(&serde_json::json!({})), None);
    }
}
