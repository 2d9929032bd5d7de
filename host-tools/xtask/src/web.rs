//! The live page as one file that needs no server: the pipeline in it as WebAssembly.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use clap::Args;
use slipsense_view::page;

use crate::process::{lock, run};
use crate::toolchain::{Toolchain, WEB_PROFILE, WEB_TARGET};

const PACKAGE: &str = "slipsense-view";

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
    let target_dir = Toolchain::of(WEB_TARGET)?.target_dir(WEB_TARGET);
    let (page, module) = make_in(out, &target_dir, &[])?;
    let [page, module] = [page, module].map(|bytes| bytes as f64 / 1e6);
    eprintln!("{}: {page:.2} MB, {module:.2} MB of them the module", out.display());
    Ok(())
}

/// The same, compiled into this folder with more flags of the compiler; bytes of the page, and of the module in it.
pub fn make_in(out: &Path, target_dir: &Path, flags: &[String]) -> Result<(usize, usize)> {
    let name = || out.display().to_string();
    {
        let _lock = lock(WEB_PROFILE)?;
        let mut build = Toolchain::of(WEB_TARGET)?.cargo_in(WEB_TARGET, "rustc", target_dir, flags);
        run(build.args(["--quiet", "--locked", "--package", PACKAGE, "--crate-type", "cdylib"]))?;
    }
    let module = target_dir.join(WEB_TARGET).join(WEB_PROFILE).join("slipsense_view.wasm");
    let module = STANDARD.encode(fs::read(module).context("the module of WebAssembly")?);
    let page = page(Some(&module));
    if let Some(folder) = out.parent() {
        fs::create_dir_all(folder).with_context(name)?;
    }
    let unfinished = out.with_extension("unfinished");
    fs::write(&unfinished, &page).and_then(|()| fs::rename(&unfinished, out)).with_context(name)?;
    Ok((page.len(), module.len()))
}
