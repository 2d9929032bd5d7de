//! Every instruction that a program does from some point on, in order.
//!
//! Writing all of it down takes the emulator a hundred times as long, so the program says when it is worth it: it
//! makes a file and waits for another. In between, the emulator's monitor switches the log on.

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use slipsense_qemu::measured::{GO_FILE, READY_FILE};

use super::machine::Machine;

/// The emulator otherwise translates stretches of instructions, chains them, and writes down where a stretch begins;
/// where it ends, it does not say.
const ONE_BY_ONE: [&str; 3] = ["-singlestep", "-d", "nochain"];
const WRITE_DOWN: &str = "log exec,nochain\ninfo status\n";
/// What the monitor answers to the second command, when the first has been done.
const DONE: &[u8] = b"VM status";
const PATIENCE: Duration = Duration::from_secs(600);

/// Run to the end and show `see` the address of each instruction.
pub fn trace(machine: &Machine, dir: &Path, mut see: impl FnMut(u32)) -> Result<()> {
    let mut child = machine
        .command(dir, "stdio")
        .args(ONE_BY_ONE)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .context("cannot start the emulator")?;
    let switched_on = switch_on(&mut child, dir);
    if let Err(error) = switched_on {
        child.kill()?;
        child.wait()?;
        return Err(error);
    }
    let log = child.stderr.take().context("the emulator has no standard error")?;
    let (mut held, mut rest) = (None, String::new());
    for line in BufReader::with_capacity(1 << 20, log).lines() {
        let line = line?;
        if let Some(pc) = address(&line) {
            // Shown one late, because the next line may take it back.
            held.replace(pc).into_iter().for_each(&mut see);
        } else if line.starts_with("Stopped execution") {
            held = None;
        } else {
            rest = rest + &line + "\n";
        }
    }
    held.into_iter().for_each(see);
    let status = child.wait()?;
    ensure!(status.success(), "the emulated program failed, {status}\n{rest}");
    Ok(())
}

/// Wait until the program is ready, switch the log on, let it go on.
fn switch_on(child: &mut Child, dir: &Path) -> Result<()> {
    let deadline = Instant::now() + PATIENCE;
    while !dir.join(READY_FILE).exists() {
        if let Some(status) = child.try_wait()? {
            bail!("the emulated program ended before the trace began, {status}");
        }
        ensure!(Instant::now() < deadline, "the emulated program is not ready to be traced");
        thread::sleep(Duration::from_millis(5));
    }
    let monitor = child.stdin.as_mut().context("the emulator's monitor takes no input")?;
    monitor.write_all(WRITE_DOWN.as_bytes())?;
    let mut answers = child.stdout.take().context("the emulator's monitor does not answer")?;
    let (mut heard, mut byte) = (Vec::new(), [0]);
    while !heard.ends_with(DONE) {
        answers.read_exact(&mut byte).context("the emulator's monitor ended")?;
        heard.extend(byte);
    }
    fs::write(dir.join(GO_FILE), "").context(GO_FILE)?;
    // Whatever else it says must not block it.
    thread::spawn(move || std::io::copy(&mut answers, &mut std::io::sink()));
    Ok(())
}

/// `Trace 0: 0x7f01 [00000000/0000a8e8/00000110/ff000000] name` is of 0xa8e8.
fn address(line: &str) -> Option<u32> {
    let (_, fields) = line.strip_prefix("Trace ")?.split_once('[')?;
    u32::from_str_radix(fields.split('/').nth(1)?, 16).ok()
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
