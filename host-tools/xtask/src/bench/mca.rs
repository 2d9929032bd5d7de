//! LLVM's model of the Cortex-M7.
//!
//! It knows both pipelines and the latencies, with memory that never waits. It does not know the caches, nor what a
//! wrong guess of a branch costs: an estimate, no measurement.

use std::collections::BTreeSet;
use std::io::Write;

use anyhow::{Context, Result, ensure};

use crate::elf::Instruction;
use crate::process::{answer, apt_install, command, find};

const PROGRAM: &str = "llvm-mca";
const PACKAGE: &str = "llvm";

/// The model's name and version; installs it where it is missing and may be installed.
pub fn model() -> Result<String> {
    if find(PROGRAM).is_none() {
        apt_install(&[PACKAGE], "estimating cycles with llvm-mca")?;
    }
    let version = answer(command(PROGRAM).arg("--version")).context("llvm-mca does not say its version")?;
    let version = version.lines().find(|line| line.contains("version")).unwrap_or_default().trim();
    Ok(format!("llvm-mca -mcpu=cortex-m7, {version}"))
}

/// What the model says of some instructions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cycles {
    pub cycles: u64,
    /// Instructions that the model does not know and that were taken for a `nop`.
    pub unknown: usize,
}

/// Cycles of these instructions, done `turns` times in a row.
pub fn cycles(instructions: &[Instruction], turns: u64) -> Result<Cycles> {
    let mut unknown = BTreeSet::new();
    loop {
        let mut file = tempfile::NamedTempFile::new().context("cannot make a file for llvm-mca")?;
        let (text, nops) = assembly(instructions, &unknown);
        file.write_all(text.as_bytes())?;
        let mut mca = command(PROGRAM);
        mca.args(["-mtriple=thumbv7em-none-eabihf", "-mcpu=cortex-m7"]);
        mca.args(["-instruction-info=0", "-resource-pressure=0"]);
        mca.arg(format!("-iterations={turns}")).arg(file.path());
        let output = mca.output().context("cannot start llvm-mca")?;
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.success() {
            let cycles = total_cycles(&String::from_utf8_lossy(&output.stdout));
            return Ok(Cycles {
                cycles: cycles.context("llvm-mca gave no number of cycles")?,
                unknown: nops,
            });
        }
        let new = refused(&errors).is_some_and(|mnemonic| unknown.insert(mnemonic));
        ensure!(new, "llvm-mca refused the instructions: {errors}");
    }
}

fn total_cycles(answer: &str) -> Option<u64> {
    let line = answer.lines().find_map(|line| line.strip_prefix("Total Cycles:"))?;
    line.trim().parse().ok()
}

/// The mnemonic of the instruction that the model does not know.
fn refused(errors: &str) -> Option<String> {
    let (_, after) = errors.split_once("unsupported instruction")?;
    let (_, instruction) = after.split_once("note: instruction:")?;
    instruction.split_whitespace().next().map(ToOwned::to_owned)
}

/// For the assembler, and how many of the `unknown` instructions became a `nop`.
///
/// Branch targets become one label, because only the kind of an instruction counts; a call becomes a branch, which
/// the model would take for 100 cycles. `it` becomes a `nop`, and what it governs is done always, which takes as
/// long.
fn assembly(instructions: &[Instruction], unknown: &BTreeSet<String>) -> (String, usize) {
    let mut text = String::from(".syntax unified\n.thumb\nturn:\n");
    let (mut governed, mut nops) = (0, 0);
    for instruction in instructions {
        let Instruction { mnemonic, operands, .. } = instruction;
        let governs = instruction.governs();
        let mnemonic = if governed > 0 { always(mnemonic) } else { mnemonic.clone() };
        governed = if governs > 0 { governs } else { governed.saturating_sub(1) };
        let line = match (instruction.direct_target(), operands.rsplit_once('#')) {
            _ if governs > 0 => "nop".to_owned(),
            _ if unknown.contains(&mnemonic) => {
                nops += 1;
                "nop".to_owned()
            }
            _ if instruction.calls() => "b turn".to_owned(),
            (Some(_), Some((before, _))) => format!("{mnemonic} {before}turn"),
            _ => format!("{mnemonic} {operands}"),
        };
        text += &line;
        text.push('\n');
    }
    (text, nops)
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
        let (text, _) = assembly(&body, &BTreeSet::new());
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
        let (text, _) = assembly(&body, &BTreeSet::new());
        assert!(text.ends_with("turn:\nnop\nmov r0, r1\nmov.w r0, r2\nadds r0, r0, r1\n"), "{text}");
    }

    #[test]
    fn what_the_model_lacks_is_a_nop() {
        let errors = "warning: found a call\nnote: call instructions\nerror: found an unsupported instruction in \
                      the input assembly sequence.\nnote: instruction: \tvcmp.f32\ts4, #0\n";
        let unknown: BTreeSet<String> = refused(errors).into_iter().collect();
        assert!(unknown.contains("vcmp.f32"));
        let body = [("vcmp.f32", "s4, #0"), ("bl", "#0x80")].map(|(mnemonic, operands)| Instruction {
            address: 0,
            bytes: 4,
            mnemonic: mnemonic.to_owned(),
            operands: operands.to_owned(),
        });
        let (text, nops) = assembly(&body, &unknown);
        assert!(text.ends_with("turn:\nnop\nb turn\n"), "{text}");
        assert_eq!(nops, 1);
    }

    #[test]
    fn cycles_are_read_from_the_summary() {
        assert_eq!(total_cycles("Iterations:        100\nTotal Cycles:      512\n"), Some(512));
        assert_eq!(total_cycles("error: no such core"), None);
    }
}
