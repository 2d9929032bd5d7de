//! A Python environment of the repository's own, for checks against independent software.

use std::fs;
use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, Result};

use crate::process::{answer, apt_install, command, run, target_dir};
use crate::root;

const REQUIREMENTS: &str = "tests/python/requirements.txt";
/// Inside the environment: the requirements that it was made from.
const STAMP: &str = "requirements.txt";

/// `python` with the packages of `tests/python/requirements.txt`; made when they change.
pub fn python() -> Result<Command> {
    let venv = target_dir().join("venv");
    let wanted = fs::read(root().join(REQUIREMENTS)).with_context(|| REQUIREMENTS.to_owned())?;
    let python = venv.join("bin/python");
    if fs::read(venv.join(STAMP)).ok() != Some(wanted.clone()) {
        make(&venv)?;
        run(command(&python)
            .args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check"])
            .args(["-r", REQUIREMENTS]))?;
        fs::write(venv.join(STAMP), wanted).with_context(|| venv.display().to_string())?;
    }
    Ok(command(python))
}

fn make(venv: &PathBuf) -> Result<()> {
    if answer(command("python3").args(["-c", "import venv, ensurepip"])).is_none() {
        apt_install(&["python3", "python3-venv"], "checking against Python")?;
    }
    run(command("python3").args(["-m", "venv", "--clear"]).arg(venv))
}
