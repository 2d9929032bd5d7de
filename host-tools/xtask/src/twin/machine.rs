//! Building `tests/twin`, and running it.
//!
//! The twin's emulator declares Rust 1.98 and builds with 1.96. It is a package of its own, so that nothing else
//! depends on that, and gets the first of these compilers that is there: the one in use, rustup's nightly, Debian's.

use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, ensure};

use crate::process::{Running, answer, apt_install, cargo, command, run as start, target_dir};

/// The oldest compiler that builds the emulator, minor version of Rust 1.
const OLDEST_MINOR: u32 = 96;
const DEBIAN_PACKAGES: [&str; 3] = ["rustc-web", "cargo-web", "rust-web-src"];
const MANIFEST: &str = "tests/twin/Cargo.toml";
pub const MODEL: &str = "model/weights/slipsense.slipnet";
/// Virtual time after which a run with pycyphal ends anyway.
const FAR_END_SECONDS: &str = "3600";

pub fn twin_with(elf: &Path) -> Result<Command> {
    // A step starts it up to 23 times.
    static IS_BUILT: Mutex<bool> = Mutex::new(false);
    let mut is_built = IS_BUILT.lock().unwrap_or_else(PoisonError::into_inner);
    if !*is_built {
        start(cargo_for("build")?.arg("--quiet"))?;
        *is_built = true;
    }
    let mut twin = command(target_dir().join("twin/release/slipsense-twin"));
    twin.arg("--elf").arg(elf);
    Ok(twin)
}

pub fn build_and_test() -> Result<()> {
    start(cargo_for("build")?.arg("--quiet"))?;
    start(cargo_for("test")?.arg("--quiet"))
}

/// An object is pulled out of a synthetic grasp: the episode's file.
pub fn synthetic_pull(slipsense: &Path, platform: &str, sensors: usize, seconds: u32) -> Result<PathBuf> {
    let [recipe, episode] = ["json", "npz"]
        .map(|kind| target_dir().join(format!("pull-{sensors}-sensors-{seconds}-s-synthetic.{kind}")));
    let text = format!(
        r#"{{"seed": 7, "scenario": "six_step", "platform": "{platform}", "sensors": {sensors}, "seconds": {seconds}}}"#
    );
    std::fs::write(&recipe, text).with_context(|| recipe.display().to_string())?;
    start(command(slipsense).args(["synth", "--recipe"]).arg(recipe).arg("--out").arg(&episode))?;
    Ok(episode)
}

/// Run the twin, with `check` at the far end of its bus, which is given the port.
pub fn with_far_end(mut twin: Command, check: impl FnOnce(&str) -> Result<()>) -> Result<()> {
    twin.args(["--far-end", "--seconds", FAR_END_SECONDS]);
    let child = twin.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
    let mut twin = Running(child.context("cannot start the twin")?);
    let mut output = BufReader::new(twin.0.stdout.take().context("the twin has a standard output")?);
    let mut port = String::new();
    output.read_line(&mut port)?;
    check(port.trim())?;
    // Before the wait: a pipe that nobody reads holds it up.
    let mut rest = String::new();
    output.read_to_string(&mut rest)?;
    let ended = twin.0.wait()?;
    eprint!("{rest}");
    ensure!(ended.success(), "the twin reports something in this run that has no reason");
    Ok(())
}

fn cargo_for(subcommand: &str) -> Result<Command> {
    let mut build = compiler()?;
    build.args([subcommand, "--release", "--locked", "--ignore-rust-version", "--manifest-path", MANIFEST]);
    build.arg("--target-dir").arg(target_dir().join("twin"));
    Ok(build)
}

fn compiler() -> Result<Command> {
    const RUSTC: &str = "/usr/bin/rustc";
    if is_new_enough(command("rustc")) {
        return Ok(cargo());
    }
    let rustup = |program| {
        let mut rustup = command("rustup");
        rustup.args(["run", "nightly", program]);
        rustup
    };
    if is_new_enough(rustup("rustc")) {
        return Ok(rustup("cargo"));
    }
    if !is_new_enough(command(RUSTC)) {
        apt_install(&DEBIAN_PACKAGES, "building the emulator of the board twin")?;
    }
    ensure!(
        is_new_enough(command(RUSTC)),
        "the board twin needs Rust 1.{OLDEST_MINOR} or newer, and none is here"
    );
    let mut debian = command("/usr/bin/cargo");
    debian.env("RUSTC", RUSTC);
    Ok(debian)
}

fn is_new_enough(mut rustc: Command) -> bool {
    // rustc 1.96.0 (ac68faa20 2026-05-25)
    let minor =
        answer(rustc.arg("--version")).and_then(|text| text.split(['.', ' ']).nth(2)?.parse::<u32>().ok());
    minor.is_some_and(|minor| minor >= OLDEST_MINOR)
}
