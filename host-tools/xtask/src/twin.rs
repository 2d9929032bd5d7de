//! The board twin: builds the firmware as it is flashed and `tests/twin`, and runs the one in the other.
//!
//! The twin's emulator declares Rust 1.98 and builds with 1.96. It is a package of its own, so that nothing else
//! depends on that, and gets the first of these compilers that is there: the one in use, rustup's nightly, Debian's.

pub mod update;

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

use crate::board::Board;
use crate::process::{answer, apt_install, cargo, command, find, run as start, target_dir};
use crate::python::python;
use crate::root;
use crate::toolchain::Toolchain;

/// The oldest compiler that builds the emulator, minor version of Rust 1.
const OLDEST_MINOR: u32 = 96;
const DEBIAN_PACKAGES: [&str; 3] = ["rustc-web", "cargo-web", "rust-web-src"];
const MANIFEST: &str = "tests/twin/Cargo.toml";
const NODE_CHECK: &str = "tests/python/check_twin_node.py";
const MODEL: &str = "model/weights/slipsense.slipnet";
/// Virtual time after which nobody waits any more for what pycyphal asks.
const FAR_END_SECONDS: &str = "3600";
/// Frames of the demo that go through the mailbox, and virtual time that is more than they need: while the program
/// waits for the next one, it flies.
const HIL_FRAMES: &str = "60";
const HIL_SECONDS: &str = "36000";
const DEMO_EPISODE: &str = "host-tools/cli/demo/episode.npz";
/// The accelerometer of the default board; another one needs a firmware of its own.
const DEFAULT_XL: &str = "adxl380";
const OTHER_XL: &str = "icm42688";
/// Virtual seconds of a long run, and what it plays with two sensors where someone has it: a pull, composed of real
/// recordings. Else a synthetic one.
const LONG_SECONDS: u32 = 20;
const REAL_PULL: &str = "../shared/real/slip_up.npz";
const LOOPBACK: &str = "slipsense-can-loopback";
const LOOPBACK_PASSED: &str = "loop back passed";

/// Run the firmware's ELF on an emulated STM32H743, in virtual time
#[derive(clap::Args)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin EPISODE.npz --xl icm42688               with that accelerometer and the firmware for it
  cargo xtask twin --seconds 3 --trouble off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin EPISODE.npz --faults                    every trouble in turn, and a table of flags and recovery
  cargo xtask twin --long                                  20 s each: two sensors, three, two ICM-42688-P
  cargo xtask twin --updates                               updates over the bus, the supply fails again and again
  cargo xtask twin --gdb 3333                              wait for a debugger on this port
All options: cargo xtask twin --help, then what `slipsense-twin --help` says")]
pub struct Options {
    /// The runs that take minutes: 20 virtual seconds with two sensors, with three, and with two ICM-42688-P
    #[arg(long, exclusive = true)]
    long: bool,
    /// The step `twin-update` with more failures of the supply: at every step of a store, and at more of the others
    #[arg(long, exclusive = true)]
    updates: bool,
    /// What the twin is given: episode and options
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// Build both and run.
pub fn run(options: &Options) -> Result<bool> {
    if options.long {
        return long();
    }
    if options.updates {
        return update::step(true).map(|()| true);
    }
    let arguments = &options.arguments;
    let status = twin(fitted(arguments))?.args(arguments).status()?;
    Ok(status.success())
}

/// The accelerometer that the arguments name.
fn fitted(arguments: &[String]) -> &str {
    let mut rest = arguments.iter();
    while let Some(argument) = rest.next() {
        if argument == "--xl" {
            return rest.next().map_or(DEFAULT_XL, String::as_str);
        }
        if let Some(part) = argument.strip_prefix("--xl=") {
            return part;
        }
    }
    DEFAULT_XL
}

/// The twin with the firmware for this accelerometer.
fn twin(xl: &str) -> Result<Command> {
    let firmware = if xl == OTHER_XL { firmware_with(OTHER_XL)? } else { Board::H743.build()? };
    let mut twin = command(build()?);
    twin.arg("--elf").arg(firmware);
    Ok(twin)
}

/// The firmware with a feature beside the board's, as the step `firmware` builds it.
fn firmware_with(feature: &str) -> Result<PathBuf> {
    let toolchain = Toolchain::get()?;
    let features = format!("{},{feature}", Board::H743.feature());
    let program = "slipsense-firmware";
    start(toolchain.build().args(["--package", "slipsense", "--bin", program, "--features", &features]))?;
    // Every firmware has this name: the next build would take its place.
    let built = toolchain.program(program);
    let kept = built.with_file_name(format!("{program}-{feature}"));
    std::fs::copy(built, &kept)?;
    Ok(kept)
}

/// 20 s each, too long for the test command.
fn long() -> Result<bool> {
    let real = root().join(REAL_PULL);
    let two = if real.exists() { real } else { synthetic_pull("umi", 2, LONG_SECONDS)? };
    let three = synthetic_pull("tesollo", 3, LONG_SECONDS)?;
    let runs = [("2", &two, DEFAULT_XL), ("3", &three, DEFAULT_XL), ("2", &two, OTHER_XL)];
    let mut good = true;
    for (sensors, episode, xl) in runs {
        println!("\n{sensors} sensors, {xl}: {LONG_SECONDS} s of {}", episode.display());
        let mut run = twin(xl)?;
        run.arg(episode).args(["--xl", xl, "--sensors", sensors, "--seconds", &LONG_SECONDS.to_string()]);
        good &= run.status()?.success();
    }
    Ok(good)
}

/// An object is pulled out of a synthetic grasp: the episode's file.
pub fn synthetic_pull(platform: &str, sensors: usize, seconds: u32) -> Result<PathBuf> {
    let [recipe, episode] = ["json", "npz"]
        .map(|kind| target_dir().join(format!("pull-{sensors}-sensors-{seconds}-s-synthetic.{kind}")));
    let text = format!(
        r#"{{"seed": 7, "scenario": "six_step", "platform": "{platform}", "sensors": {sensors}, "seconds": {seconds}}}"#
    );
    std::fs::write(&recipe, text).with_context(|| recipe.display().to_string())?;
    let mut synth = cargo();
    synth.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--", "synth", "--recipe"]);
    start(synth.arg(recipe).arg("--out").arg(&episode))?;
    Ok(episode)
}

/// In the test command: the FDCAN model by itself, and embassy's driver on it; without sensors; the demo episode, with
/// either accelerometer; and that the scan computed where somebody looks is the scan event by event.
pub fn step() -> Result<()> {
    start(&mut cargo_for("test")?)?;
    loopback()?;
    start(twin(DEFAULT_XL)?.args(["--seconds", "0.2"]))?;
    let episode = root().join(DEMO_EPISODE);
    for xl in [DEFAULT_XL, OTHER_XL] {
        start(twin(xl)?.arg(&episode).args(["--xl", xl, "--seconds", "1"]))?;
    }
    let traces = [false, true].map(|slow| target_dir().join(if slow { "slow.trace" } else { "fast.trace" }));
    for (trace, slow) in traces.iter().zip([false, true]) {
        let mut run = twin(DEFAULT_XL)?;
        run.arg(&episode).args(["--seconds", "0.12", "--trace"]).arg(trace);
        start(run.args(slow.then_some("--slow")))?;
    }
    let [fast, slow] = traces.map(|path| std::fs::read(&path).with_context(|| path.display().to_string()));
    ensure!(fast? == slow?, "the twin with --slow does not do what it does without");
    Ok(())
}

/// In the test command: every trouble in turn.
pub fn faults_step() -> Result<()> {
    start(twin(DEFAULT_XL)?.arg(root().join(DEMO_EPISODE)).arg("--faults"))
}

/// embassy's own CAN driver sends to itself through the modelled peripheral.
fn loopback() -> Result<()> {
    let toolchain = Toolchain::get()?;
    let mut firmware = toolchain.build_with_stack_sizes();
    firmware.args(["--package", "slipsense", "--bin", LOOPBACK, "--features", Board::H743.feature()]);
    start(&mut firmware)?;
    let mut run = command(build()?);
    run.arg("--elf").arg(toolchain.program(LOOPBACK));
    start(run.args(["--seconds", "0.2", "--says", LOOPBACK_PASSED]))
}

/// In the test command: pycyphal talks to the node of the firmware, through the modelled bus.
pub fn node_step() -> Result<()> {
    let firmware = Board::H743.build()?;
    with_far_end(&firmware, &[], |port| start(python()?.arg(NODE_CHECK).arg(port).args(["--model", MODEL])))
}

/// Run the twin, with these more arguments, and with `check` at the far end of its bus, which is told the port.
fn with_far_end(firmware: &Path, more: &[&str], check: impl FnOnce(&str) -> Result<()>) -> Result<()> {
    let mut twin = command(build()?);
    twin.arg("--elf").arg(firmware).args(["--far-end", "--seconds", FAR_END_SECONDS]).args(more);
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
    // Before the wait: a pipe that nobody reads holds it up.
    let mut rest = String::new();
    said.read_to_string(&mut rest)?;
    let ended = child.wait()?;
    eprint!("{rest}");
    checked?;
    ensure!(ended.success(), "the twin told something of this run that has no reason");
    Ok(())
}

/// In the test command: `slipsense hil`, with the program that it has on a board on the emulated STM32H743.
pub fn hil_step() -> Result<()> {
    let program = Board::H743.build_hil()?;
    let mut twin = command(build()?);
    twin.arg("--elf").arg(&program).args(["--gdb", "0", "--seconds", HIL_SECONDS]);
    let mut child = twin.stderr(Stdio::piped()).spawn().context("cannot start the twin")?;
    // Kept until the end: the twin may say more.
    let mut said = BufReader::new(child.stderr.take().context("the twin has a standard error")?);
    let mut first = String::new();
    let read = said.read_line(&mut first);
    let checked = match first.trim().rsplit_once(' ') {
        Some((_, address)) if first.starts_with("waiting for a debugger") => {
            let mut hil = cargo();
            hil.args([
                "run",
                "--release",
                "--quiet",
                "--package",
                "slipsense-cli",
                "--",
                "hil",
                DEMO_EPISODE,
            ]);
            hil.arg("--elf").arg(&program).args(["--frames", HIL_FRAMES, "--timeout-s", "60"]);
            start(hil.args(["--gdb", address]))
        }
        _ => read.map_err(Into::into).and_then(|_| bail!("the twin serves no debugger: {first}")),
    };
    // It would go on until its time is over.
    let _ = child.kill();
    child.wait()?;
    checked
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
