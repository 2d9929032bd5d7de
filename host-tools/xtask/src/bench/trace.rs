//! Every instruction of one `Pipeline::step` on the emulated board, in order, by function.
//!
//! Writing all of it down takes the emulator a hundred times as long, so the program says when it is worth it: it
//! makes a file and waits for another. In between, the emulator's monitor switches the log on.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::Stdio;
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use slipsense_qemu::measured::{GO_FILE, READY_FILE, TRACE_FILE, WARM_UP_FRAMES};

use super::emulated::{Measured, PROGRAM};
use super::inputs::Input;
use crate::elf::{Code, Image, Instruction};
use crate::process::Running;
use crate::qemu::machine::{Machine, folder};

/// Where the frame path begins.
const STEP: &str = "pipeline::Pipeline>::step";
/// The emulator otherwise translates stretches of instructions, chains them, and writes down where a stretch begins;
/// where it ends, it does not say.
const ONE_BY_ONE: [&str; 3] = ["-singlestep", "-d", "nochain"];
const WRITE_DOWN: &str = "log exec,nochain\ninfo status\n";
/// What the monitor answers to the second command, when the first has been done.
const DONE: &[u8] = b"VM status";
const TIMEOUT: Duration = Duration::from_secs(600);

/// By function what was done of it, in order, whatever was done between.
pub type Trace = BTreeMap<String, Vec<Instruction>>;

/// Trace the last of enough frames to fill every window; also how many instructions its step was measured to take.
pub fn step(model: &[u8], input: Input, sensors: usize) -> Result<(Trace, u32)> {
    let machine = Machine::build(PROGRAM)?;
    let dir = folder(&input.frames(sensors, WARM_UP_FRAMES + 1)?, model)?;
    fs::write(dir.path().join(TRACE_FILE), "").context(TRACE_FILE)?;
    let addresses = addresses(&machine, dir.path())?;
    let measured = Measured::read(dir.path())?;
    let [step, _] = *measured.frames.last().context("the emulated program measured no frame")?;
    Ok((first_step(&Image::read(&machine.program)?, &addresses)?, step))
}

/// Run to the end; the address of each instruction that is done.
fn addresses(machine: &Machine, dir: &Path) -> Result<Vec<u32>> {
    let mut emulator = machine.command(dir, "stdio");
    emulator.args(ONE_BY_ONE).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut emulator = Running(emulator.spawn().context("cannot start the emulator")?);
    switch_on(&mut emulator, dir)?;
    let log = emulator.0.stderr.take().context("the emulator has no standard error")?;
    let (mut done, mut held, mut rest) = (Vec::new(), None, String::new());
    for line in BufReader::with_capacity(1 << 20, log).lines() {
        let line = line?;
        if let Some(pc) = address(&line) {
            // Held until the next line, which may take it back.
            done.extend(held.replace(pc));
        } else if line.starts_with("Stopped execution") {
            held = None;
        } else {
            rest = rest + &line + "\n";
        }
    }
    done.extend(held);
    let status = emulator.0.wait()?;
    ensure!(status.success(), "the emulated program failed, {status}\n{rest}");
    Ok(done)
}

/// Wait until the program is ready, switch the log on, let it go on.
fn switch_on(emulator: &mut Running, dir: &Path) -> Result<()> {
    let deadline = Instant::now() + TIMEOUT;
    while !dir.join(READY_FILE).exists() {
        if let Some(status) = emulator.0.try_wait()? {
            bail!("the emulated program ended before the trace began, {status}");
        }
        ensure!(Instant::now() < deadline, "the emulated program is not ready to be traced");
        thread::sleep(Duration::from_millis(5));
    }
    let monitor = emulator.0.stdin.as_mut().context("the emulator's monitor takes no input")?;
    monitor.write_all(WRITE_DOWN.as_bytes())?;
    let mut answers = emulator.0.stdout.take().context("the emulator's monitor does not answer")?;
    let (mut answer, mut byte) = (Vec::new(), [0]);
    while !answer.ends_with(DONE) {
        answers.read_exact(&mut byte).context("the emulator's monitor ended")?;
        answer.extend(byte);
    }
    fs::write(dir.join(GO_FILE), "").context(GO_FILE)?;
    // Whatever else it writes must not block it.
    thread::spawn(move || std::io::copy(&mut answers, &mut std::io::sink()));
    Ok(())
}

/// `Trace 0: 0x7f01 [00000000/0000a8e8/00000110/ff000000] name` is of 0xa8e8.
fn address(line: &str) -> Option<u32> {
    let (_, fields) = line.strip_prefix("Trace ")?.split_once('[')?;
    u32::from_str_radix(fields.split('/').nth(1)?, 16).ok()
}

/// The instructions of the first step among those at these addresses: until its caller goes on.
fn first_step(image: &Image, addresses: &[u32]) -> Result<Trace> {
    let step = image.functions.iter().find(|function| function.name.ends_with(STEP));
    let step = step.with_context(|| format!("the program has no function `{STEP}`"))?.address;
    let begin = addresses.iter().position(|&pc| u64::from(pc) == step).unwrap_or(addresses.len());
    let (before, rest) = addresses.split_at(begin);
    let caller = before.last().and_then(|&pc| image.function_at(pc.into()));
    let code = Code::new()?;
    let mut known: HashMap<u64, Vec<Instruction>> = HashMap::new();
    let mut functions = Trace::new();
    for &pc in rest {
        let index = image.function_at(pc.into());
        if index == caller {
            return Ok(functions);
        }
        let function = &image.functions[index.with_context(|| format!("no function at {pc:#x}"))?];
        if let Entry::Vacant(new) = known.entry(function.address) {
            new.insert(code.disassemble(image, function)?);
        }
        let instructions = &known[&function.address];
        let done = instructions.binary_search_by_key(&u64::from(pc), |instruction| instruction.address);
        let done = done.ok().with_context(|| format!("no instruction at {pc:#x} in {}", function.name))?;
        functions.entry(function.name.clone()).or_default().push(instructions[done].clone());
    }
    bail!("the emulated program did not come back from `{STEP}`")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_trace_holds_the_address() {
        let line = "Trace 0: 0x7f2b7c000100 [00000000/0000a8e8/00000110/ff000000] conv";
        assert_eq!(address(line), Some(0xa8e8));
        assert_eq!(address("Stopped execution of TB chain before 0x7f [0000a8e8] conv"), None);
    }
}
