//! The analog front end: schematic as code and simulation, by the scripts in `host-tools/front-end`.

use std::path::Path;

use anyhow::Result;
use clap::Args;

use crate::process::{apt_install, find, python_with, run, target_dir};

const SCRIPT: &str = "host-tools/front-end/check.py";
const REQUIREMENTS: &str = "host-tools/front-end/requirements.txt";
/// Of Debian's package `kicad-symbols`.
const SYMBOLS: &str = "/usr/share/kicad/symbols";

#[derive(Args, Default)]
#[command(after_help = "\
Prints the electrical rules, every net at the board against the firmware's pins and the wiring page, settling, static \
crosstalk, phase margins, swing and noise of the simulation, the model against the simulation, and how the former \
circuit fails. Netlists and bills of materials are in target/front-end.")]
pub struct Options {
    /// Write the generator's constants and samples anew
    #[arg(long)]
    write: bool,
}

/// All of it; fails where a requirement is missed or a committed table differs.
pub fn check(options: &Options) -> Result<()> {
    if find("ngspice").is_none() || !Path::new(SYMBOLS).exists() {
        apt_install(&["ngspice", "kicad-symbols"], "simulating the front end")?;
    }
    let mut check = python_with("front-end-venv", REQUIREMENTS)?;
    check.arg(SCRIPT).arg(target_dir().join("front-end"));
    if options.write {
        check.arg("--write");
    }
    run(&mut check)
}
