//! The Python package: its wheel, where nothing else is, and beside the packages that it works with.
//!
//! lerobot is a command of its own: with PyTorch it is a download of 3 GB.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result};

use crate::process::{DEMO_EPISODE, command, empty_dir, python, python_with, run, target_dir, with_lints};

const INSTALL: [&str; 5] = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check"];
const NOTEBOOK: &str = "docs/src/tools/episode.ipynb";

fn wheel() -> Result<PathBuf> {
    let wheels = empty_dir("wheels")?;
    let mut build = with_lints(python()?);
    build.args(["-m", "maturin", "build", "--release", "--quiet", "--out"]).arg(&wheels);
    run(build.args(["--manifest-path", "host-tools/python/Cargo.toml"]))?;
    let wheel = std::fs::read_dir(wheels)?.next().context("maturin made no wheel")??;
    Ok(wheel.path())
}

/// `python` in an environment with the packages of a list, and the wheel.
fn python_beside(name: &str, requirements: &str, wheel: &Path) -> Result<impl Fn(&str) -> Command> {
    let python = python_with(name, requirements)?.get_program().to_owned();
    run(command(&python).args(INSTALL).args(["--no-deps", "--force-reinstall"]).arg(wheel))?;
    Ok(move |script: &str| {
        let mut check = command(&python);
        check.arg(format!("tests/python/{script}"));
        check
    })
}

/// The step of the test command. `demo`: what `slipsense demo` wrote.
pub fn step(demo: &Path) -> Result<()> {
    let (wheel, empty) = (wheel()?, target_dir().join("wheel-venv"));
    run(python()?.args(["-m", "venv", "--clear"]).arg(&empty))?;
    run(command(empty.join("bin/python")).args(INSTALL).arg(&wheel))?;
    run(command(empty.join("bin/slipsense")).arg("--help"))?;

    let check = python_beside("package-venv", "tests/python/package-requirements.txt", &wheel)?;
    let [predictions, log] = ["predictions.npz", "can.log"].map(|file| demo.join(file));
    run(check("check_package.py").arg(DEMO_EPISODE).arg(predictions).arg(log))?;
    run(check("check_notebook.py").arg(NOTEBOOK))?;
    run(check("check_cluster.py").arg(empty_dir("cluster")?).arg("model/weights/slipsense.safetensors"))
}

/// lerobot writes our episodes and reads them.
pub fn lerobot() -> Result<()> {
    let wheel = wheel()?;
    let check = python_beside("lerobot-venv", "tests/python/lerobot-requirements.txt", &wheel)?;
    run(check("check_lerobot.py").arg(DEMO_EPISODE).arg(empty_dir("lerobot")?))
}
