//! Which compiler builds for the Cortex-M7, and for WebAssembly.
//!
//! 1. The target of the compiler in use, if it is installed.
//! 2. Else rustup installs it.
//! 3. Else, or where the environment variable `SLIPSENSE_TOOLCHAIN` is `debian`: Debian's compiler, which
//!    builds the standard library from Debian's sources. It has a target directory of its own, because its
//!    version differs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

use anyhow::{Result, bail, ensure};

use crate::process::{answer, apt_install, cargo, command, find, lock, of_our_toolchain, run, target_dir};

/// The Cortex-M7 with double-precision FPU.
pub const TARGET: &str = "thumbv7em-none-eabihf";
pub const WEB_TARGET: &str = "wasm32-unknown-unknown";
pub const WEB_PROFILE: &str = "web";
const VARIABLE: &str = "SLIPSENSE_TOOLCHAIN";
const DEBIAN_PACKAGES: [&str; 4] = ["rustc-web", "cargo-web", "rust-web-src", "lld"];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Toolchain {
    /// The one that built this program.
    Host,
    /// Debian's packages.
    Debian,
}

impl Toolchain {
    /// Find or install one for the Cortex-M7.
    pub fn get() -> Result<Self> {
        Self::of(TARGET)
    }

    /// Find or install one for a target. Decided once per run.
    pub fn of(target: &'static str) -> Result<Self> {
        static DECIDED: Mutex<BTreeMap<&str, Toolchain>> = Mutex::new(BTreeMap::new());
        let mut decided = DECIDED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(&toolchain) = decided.get(target) {
            return Ok(toolchain);
        }
        let toolchain = decide(target)?;
        decided.insert(target, toolchain);
        Ok(toolchain)
    }

    /// `cargo build` or another command for the Cortex-M7, with the profile for the board and warnings denied. The
    /// compiler lists what each function takes of the stack, which leaves the code as it is. All builds have the same
    /// flags, so that they share their dependencies. Names of functions are looked up in the program, so every compiler
    /// has to write them the same way.
    pub fn cargo(self, subcommand: &str) -> Command {
        self.cargo_in(TARGET, subcommand, &self.target_dir(TARGET), &[])
    }

    /// The same for any target and into another folder, with more flags of the compiler. WebAssembly gets the vector
    /// instructions that every browser of today has.
    pub fn cargo_in(self, target: &str, subcommand: &str, target_dir: &Path, more: &[String]) -> Command {
        let (profile, libraries, linker, ours) = match target {
            WEB_TARGET => (WEB_PROFILE, "std,panic_abort", "wasm-ld", &["-Ctarget-feature=+simd128"][..]),
            _ => ("firmware", "core", "ld.lld", &["-Csymbol-mangling-version=v0", "-Zemit-stack-sizes"][..]),
        };
        let mut flags = vec!["-Dwarnings"];
        flags.extend(ours.iter().copied().chain(more.iter().map(String::as_str)));
        let mut build = match self {
            Self::Host => cargo(),
            Self::Debian => command("/usr/bin/cargo"),
        };
        // The compiler calls some options unstable, hence the permission.
        build.env("RUSTC_BOOTSTRAP", "1");
        build.args([subcommand, "--profile", profile, "--target", target, "--target-dir"]);
        build.arg(target_dir);
        // Adds to the flags in .cargo/config.toml; the variable RUSTFLAGS would replace them.
        build.args(["--config", &format!("target.{target}.rustflags={flags:?}")]);
        if self == Self::Debian {
            let variable = format!("CARGO_TARGET_{}_LINKER", target.to_uppercase().replace('-', "_"));
            build.env("RUSTC", "/usr/bin/rustc").env(variable, linker);
            build.arg(format!("-Zbuild-std={libraries}"));
        }
        build
    }

    /// What its compiler calls itself.
    pub fn version(self) -> Option<String> {
        let mut rustc = match self {
            Self::Host => of_our_toolchain("rustc"),
            Self::Debian => command("/usr/bin/rustc"),
        };
        answer(rustc.arg("--version"))
    }

    pub fn program(self, name: &str) -> PathBuf {
        self.target_dir(TARGET).join(TARGET).join("firmware").join(name)
    }

    pub fn target_dir(self, target: &str) -> PathBuf {
        match self {
            Self::Host => target_dir(),
            Self::Debian => target_dir().join(if target == TARGET { "debian-thumb" } else { "debian-wasm" }),
        }
    }
}

fn decide(target: &str) -> Result<Toolchain> {
    // Steps of the test command would install the same at the same time.
    let _lock = lock("toolchain")?;
    match std::env::var(VARIABLE).as_deref() {
        Err(_) | Ok("") => {}
        Ok("debian") => return debian(target, &format!("{VARIABLE} asks for it")),
        Ok(other) => bail!("{VARIABLE} is `{other}`; it may be `debian` or unset"),
    }
    if is_installed(target) {
        return Ok(Toolchain::Host);
    }
    if find("rustup").is_some() {
        eprintln!("rustup adds the target {target}");
        match run(of_our_toolchain("rustup").args(["target", "add", target])) {
            Ok(()) => return Ok(Toolchain::Host),
            Err(error) => eprintln!("rustup cannot: {error}"),
        }
    }
    debian(target, "the target is not installed and rustup cannot add it")
}

fn is_installed(target: &str) -> bool {
    let libdir = answer(of_our_toolchain("rustc").args(["--print", "target-libdir", "--target", target]));
    let holds_core = |dir: &Path| {
        let names = dir.read_dir().into_iter().flatten().flatten();
        names.map(|entry| entry.file_name()).any(|name| name.to_string_lossy().starts_with("libcore-"))
    };
    libdir.is_some_and(|dir| holds_core(Path::new(&dir)))
}

fn debian(target: &str, why: &str) -> Result<Toolchain> {
    if !debian_is_complete() {
        apt_install(&DEBIAN_PACKAGES, &format!("building for {target} with Debian's compiler"))?;
    }
    let packages = DEBIAN_PACKAGES.join(" ");
    ensure!(
        debian_is_complete(),
        "Debian's compiler is incomplete: {packages} are installed, yet core is missing"
    );
    let version = Toolchain::Debian.version().unwrap_or_default();
    eprintln!("compiler for {target}: Debian's {version}, {why}");
    Ok(Toolchain::Debian)
}

fn debian_is_complete() -> bool {
    let files = ["/usr/bin/rustc", "/usr/bin/cargo", "/usr/lib/rustlib/src/rust/library/core/src/lib.rs"];
    files.iter().all(|file| Path::new(file).exists()) && find("ld.lld").is_some()
}
