//! The board twin: builds the firmware as it is flashed and `tests/twin`, and runs the one in the other.
//!
//! The twin's emulator declares Rust 1.98 and builds with 1.96. It is a package of its own, so that nothing else
//! depends on that, and gets the first of these compilers that is there: the one in use, rustup's nightly, Debian's.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

use crate::board::Board;
use crate::process::{answer, apt_install, cargo, command, find, run as start, target_dir};
use crate::python::python;
use crate::root;

/// The oldest compiler that builds the emulator, minor version of Rust 1.
const OLDEST_MINOR: u32 = 96;
const DEBIAN_PACKAGES: [&str; 3] = ["rustc-web", "cargo-web", "rust-web-src"];
const MANIFEST: &str = "tests/twin/Cargo.toml";
const NODE_CHECK: &str = "tests/python/check_twin_node.py";
const UPDATE_CHECK: &str = "tests/python/check_twin_update.py";
const MODEL: &str = "model/weights/slipsense.slipnet";
/// Virtual time after which nobody waits any more for what pycyphal asks.
const FAR_END_SECONDS: &str = "600";
const DEMO_EPISODE: &str = "host-tools/cli/demo/episode.npz";

/// Run the firmware's ELF on an emulated STM32H743, in virtual time
#[derive(clap::Args)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin --seconds 3 --trouble off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin --gdb 3333                              wait for a debugger on this port
All options: cargo xtask twin --help, then what `slipsense-twin --help` says")]
pub struct Options {
    /// What the twin is given: episode and options
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Build both and run.
pub fn run(options: &Options) -> Result<bool> {
    let firmware = Board::H743.build()?;
    let twin = build()?;
    let status = command(twin).arg("--elf").arg(firmware).args(&options.arguments).status()?;
    Ok(status.success())
}

/// In the test command: the FDCAN model by itself; without sensors; the demo episode; and that the scan computed where
/// somebody looks is the scan event by event.
pub fn step() -> Result<()> {
    let firmware = Board::H743.build()?;
    start(&mut cargo_for("test")?)?;
    let twin = build()?;
    let run = || {
        let mut run = command(&twin);
        run.arg("--elf").arg(&firmware);
        run
    };
    start(run().args(["--seconds", "0.2"]))?;
    let episode = root().join(DEMO_EPISODE);
    start(run().arg(&episode).args(["--seconds", "1"]))?;
    let traces = [false, true].map(|slow| target_dir().join(if slow { "slow.trace" } else { "fast.trace" }));
    for (trace, slow) in traces.iter().zip([false, true]) {
        let mut run = run();
        run.arg(&episode).args(["--seconds", "0.12", "--trace"]).arg(trace);
        start(run.args(slow.then_some("--slow")))?;
    }
    let [fast, slow] = traces.map(|path| std::fs::read(&path).with_context(|| path.display().to_string()));
    ensure!(fast? == slow?, "the twin with --slow does not do what it does without");
    Ok(())
}

/// In the test command: pycyphal talks to the node of the firmware, through the modelled bus.
pub fn node_step() -> Result<()> {
    let firmware = Board::H743.build()?;
    with_far_end(&firmware, None, |port| start(python()?.arg(NODE_CHECK).arg(port).args(["--model", MODEL])))
}

/// In the test command: pycyphal updates firmware and model of the board over the modelled bus, with the bootloader in
/// place; the supply fails in between.
pub fn update_step() -> Result<()> {
    let firmware = Board::H743.build()?;
    let boot = Board::build_bootloader()?;
    let images = tempfile::tempdir().context("cannot make a folder for the images")?;
    let firmware_file = firmware.display().to_string();
    for (file, version, board, name) in [
        (firmware_file.as_str(), "0.2.0", Some("h743"), "new.slip"),
        (firmware_file.as_str(), "0.0.1", Some("h743"), "older.slip"),
        (MODEL, "1.0.0", None, "model.slip"),
        (MODEL, "1.0.0", Some("h723"), "other.slip"),
    ] {
        let mut sign = cargo();
        sign.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--", "sign", file]);
        sign.args(["--version", version, "--development-key", "--out"]).arg(images.path().join(name));
        start(sign.args(board.map(|board| ["--board", board]).into_iter().flatten()))?;
    }
    with_far_end(&firmware, Some(&boot), |port| {
        start(python()?.arg(UPDATE_CHECK).arg(port).arg("--folder").arg(images.path()))
    })
}

/// Run the twin with `check` at the far end of its bus, which is told the port.
fn with_far_end(firmware: &Path, boot: Option<&Path>, check: impl FnOnce(&str) -> Result<()>) -> Result<()> {
    let mut twin = command(build()?);
    twin.arg("--elf").arg(firmware).args(["--far-end", "--seconds", FAR_END_SECONDS]);
    if let Some(boot) = boot {
        twin.arg("--boot").arg(boot);
    }
    let child = twin.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
    let mut child = child.context("cannot start the twin")?;
    let mut said = BufReader::new(child.stdout.take().context("the twin has a standard output")?);
    let mut port = String::new();
    said.read_line(&mut port)?;
    let checked = check(port.trim());
    if checked.is_err() {
        // It may have ended by itself.
        let _ = child.kill();
    }
    let ended = child.wait()?;
    let mut rest = String::new();
    said.read_to_string(&mut rest)?;
    eprint!("{rest}");
    checked?;
    ensure!(ended.success(), "the twin told something of this run that has no reason");
    Ok(())
}

/// The program.
fn build() -> Result<PathBuf> {
    start(&mut cargo_for("build")?)?;
    Ok(target_dir().join("twin/release/slipsense-twin"))
}

/// `cargo build` or `cargo test` of the package.
fn cargo_for(what: &str) -> Result<Command> {
    let target = target_dir().join("twin");
    let mut build = compiler()?;
    build.args([
        what,
        "--release",
        "--quiet",
        "--locked",
        "--ignore-rust-version",
        "--manifest-path",
        MANIFEST,
    ]);
    build.arg("--target-dir").arg(&target);
    Ok(build)
}

fn compiler() -> Result<Command> {
    if is_new_enough(command("rustc").arg("--version")) {
        return Ok(cargo());
    }
    if find("rustup").is_some()
        && is_new_enough(command("rustup").args(["run", "nightly", "rustc", "--version"]))
    {
        eprintln!("twin: built with rustup's nightly");
        let mut nightly = command("rustup");
        nightly.args(["run", "nightly", "cargo"]);
        return Ok(nightly);
    }
    if !is_new_enough(command("/usr/bin/rustc").arg("--version")) {
        apt_install(&DEBIAN_PACKAGES, "building the emulator of the board twin")?;
    }
    if !is_new_enough(command("/usr/bin/rustc").arg("--version")) {
        bail!("the board twin needs Rust 1.{OLDEST_MINOR} or newer, and none is here");
    }
    eprintln!("twin: built with Debian's compiler");
    let mut debian = command("/usr/bin/cargo");
    debian.env("RUSTC", "/usr/bin/rustc");
    Ok(debian)
}

fn is_new_enough(version: &mut Command) -> bool {
    // rustc 1.96.0 (ac68faa20 2026-05-25)
    let minor = answer(version).and_then(|text| text.split(['.', ' ']).nth(2)?.parse::<u32>().ok());
    minor.is_some_and(|minor| minor >= OLDEST_MINOR)
}
