//! An estimate of the cycles of `Pipeline::step`: all its instructions through LLVM's model of the Cortex-M7.
//!
//! The model knows both pipelines and the latencies, with memory that never waits. It does not know the caches, nor
//! what a wrongly predicted branch costs: an estimate, no measurement.

use std::collections::BTreeSet;
use std::io::Write;

use anyhow::{Context, Result, ensure};
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS};

use super::inputs::Input;
use super::trace;
use crate::elf::Instruction;
use crate::process::{answer, command, need};
use crate::table::{Table, thousands};

const PROGRAM: &str = "llvm-mca";
const PACKAGE: &str = "llvm";
const INPUT: Input = Input::Typical;
const CLOCK_HZ: u32 = 480_000_000;

/// Trace a step with full windows for each number of sensors, and print the estimates.
pub fn print(model: &[u8]) -> Result<()> {
    need(PROGRAM, &[PACKAGE], "estimating cycles with llvm-mca")?;
    let version = answer(command(PROGRAM).arg("--version")).context("llvm-mca does not say its version")?;
    let version = version.lines().find(|line| line.contains("version")).unwrap_or_default().trim();
    let mut table = Table::new(
        format!(
            "Cycles of Pipeline::step, ESTIMATE by llvm-mca -mcpu=cortex-m7, {version}, memory without waits"
        ),
        &["sensors", "input", "instructions, exact", "cycles, est.", "of a frame at 480 MHz, est."],
    );
    for sensors in 1..=MAX_SENSORS {
        eprintln!("{sensors} sensors, {}: tracing a step on the emulated Cortex-M7", INPUT.name());
        let (functions, measured) = trace::step(model, INPUT, sensors)?;
        let traced: usize = functions.values().map(Vec::len).sum();
        // Handing over the result is measured, and lies outside the trace.
        ensure!(
            traced.abs_diff(measured as usize) * 100 <= measured as usize,
            "the trace of a step holds {traced} instructions, it was measured to take {measured}"
        );
        let estimates = functions.iter().map(|(name, code)| cycles(code).with_context(|| name.clone()));
        let cycles = estimates.sum::<Result<u64>>()?;
        let share = cycles as f64 / f64::from(CLOCK_HZ / FRAME_RATE_HZ);
        table.row([
            sensors.to_string(),
            INPUT.name().to_owned(),
            thousands(measured),
            thousands(cycles),
            format!("{:.0} %", 100.0 * share),
        ]);
    }
    print!("{table}");
    Ok(())
}

fn cycles(instructions: &[Instruction]) -> Result<u64> {
    let mut unknown = BTreeSet::new();
    loop {
        let mut file = tempfile::NamedTempFile::new().context("cannot make a file for llvm-mca")?;
        file.write_all(assembly(instructions, &unknown).as_bytes())?;
        let mut mca = command(PROGRAM);
        mca.args(["-mtriple=thumbv7em-none-eabihf", "-mcpu=cortex-m7", "-iterations=1"]);
        mca.args(["-instruction-info=0", "-resource-pressure=0"]).arg(file.path());
        let output = mca.output().context("cannot start llvm-mca")?;
        let errors = String::from_utf8_lossy(&output.stderr);
        if output.status.success() {
            let answer = String::from_utf8_lossy(&output.stdout);
            return total_cycles(&answer).context("llvm-mca gave no number of cycles");
        }
        let new = refused(&errors).is_some_and(|mnemonic| unknown.insert(mnemonic));
        ensure!(new, "llvm-mca refused the instructions: {errors}");
    }
}

fn total_cycles(answer: &str) -> Option<u64> {
    answer.lines().find_map(|line| line.strip_prefix("Total Cycles:")?.trim().parse().ok())
}

/// The mnemonic of the instruction that the model does not know.
fn refused(errors: &str) -> Option<String> {
    let (_, after) = errors.split_once("unsupported instruction")?;
    let (_, instruction) = after.split_once("note: instruction:")?;
    instruction.split_whitespace().next().map(ToOwned::to_owned)
}

/// For the assembler; an `unknown` instruction becomes a `nop`.
///
/// Branch targets become one label, because only the kind of an instruction counts; a call becomes a branch, which
/// the model would take for 100 cycles. `it` becomes a `nop`, and what it governs is done always, which takes as
/// long.
fn assembly(instructions: &[Instruction], unknown: &BTreeSet<String>) -> String {
    let mut text = String::from(".syntax unified\n.thumb\nturn:\n");
    let mut governed = 0;
    for instruction in instructions {
        let Instruction { mnemonic, operands, .. } = instruction;
        let governs = instruction.governs();
        let mnemonic = if governed > 0 { always(mnemonic) } else { mnemonic.clone() };
        governed = if governs > 0 { governs } else { governed.saturating_sub(1) };
        text += &match (instruction.direct_target(), operands.rsplit_once('#')) {
            _ if governs > 0 || unknown.contains(&mnemonic) => "nop".to_owned(),
            _ if instruction.calls() => "b turn".to_owned(),
            (Some(_), Some((before, _))) => format!("{mnemonic} {before}turn"),
            _ => format!("{mnemonic} {operands}"),
        };
        text.push('\n');
    }
    text
}

/// `movlo.w` to `mov.w`.
fn always(mnemonic: &str) -> String {
    let end = mnemonic.find('.').unwrap_or(mnemonic.len());
    let (plain, width) = mnemonic.split_at(end);
    format!("{}{width}", &plain[..plain.len().saturating_sub(2)])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assembly_keeps_what_the_model_needs() {
        let errors = "warning: found a call\nnote: call instructions\nerror: found an unsupported instruction in \
                      the input assembly sequence.\nnote: instruction: \tvcmp.f32\ts4, #0\n";
        let unknown: BTreeSet<String> = refused(errors).into_iter().collect();
        let lines = [
            ("smlad", "r0, r1, r2, r0", "smlad r0, r1, r2, r0"),
            ("cbz", "r3, #0x90", "cbz r3, turn"),
            ("bne.w", "#0x80", "bne.w turn"),
            ("bl", "#0x80", "b turn"),
            ("ite", "lo", "nop"),
            ("movlo", "r0, r1", "mov r0, r1"),
            ("movhs.w", "r0, r2", "mov.w r0, r2"),
            ("adds", "r0, r0, r1", "adds r0, r0, r1"),
            ("vcmp.f32", "s4, #0", "nop"),
        ];
        let code = lines.map(|(mnemonic, operands, _)| Instruction {
            mnemonic: mnemonic.to_owned(),
            operands: operands.to_owned(),
            ..Instruction::default()
        });
        let text = assembly(&code, &unknown);
        let expected: Vec<_> = lines.iter().map(|(.., line)| *line).collect();
        assert_eq!(text.lines().skip(3).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn cycles_are_read_from_the_summary() {
        assert_eq!(total_cycles("Iterations:        100\nTotal Cycles:      512\n"), Some(512));
        assert_eq!(total_cycles("error: no such core"), None);
    }
}
