//! The live page as one file that needs no server: the pipeline in it as WebAssembly.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use clap::Args;
use slipsense_view::page;

use crate::process::{lock, run};
use crate::toolchain::{Toolchain, WEB_TARGET};

const PACKAGE: &str = "slipsense-view";
const PROFILE: &str = "web";

#[derive(Args, Clone, Debug)]
#[command(after_help = "\
The file opens from a disk or from any server of static files. The compiler for WebAssembly comes from rustup or, with
SLIPSENSE_TOOLCHAIN=debian, from Debian's packages.

Example:
  cargo xtask web --out out/slipsense.html")]
pub struct Options {
    /// The file to write
    #[arg(long, value_name = "FILE", default_value = "out/slipsense.html")]
    pub out: PathBuf,
}

pub fn make(Options { out }: &Options) -> Result<()> {
    let name = || out.display().to_string();
    let module = STANDARD.encode(fs::read(build()?).context("the module of WebAssembly")?);
    let page = page(Some(&module));
    if let Some(folder) = out.parent() {
        fs::create_dir_all(folder).with_context(name)?;
    }
    let unfinished = out.with_extension("unfinished");
    fs::write(&unfinished, &page).and_then(|()| fs::rename(&unfinished, out)).with_context(name)?;
    eprintln!(
        "{}: {:.2} MB, {:.2} MB of them the module",
        name(),
        page.len() as f64 / 1e6,
        module.len() as f64 / 1e6
    );
    Ok(())
}

fn build() -> Result<PathBuf> {
    let _lock = lock(PROFILE)?;
    let toolchain = Toolchain::of(WEB_TARGET)?;
    let mut build = toolchain.web_cargo("rustc", PROFILE);
    run(build.args(["--quiet", "--package", PACKAGE, "--crate-type", "cdylib"]))?;
    Ok(toolchain.output(WEB_TARGET, PROFILE).join("slipsense_view.wasm"))
}
