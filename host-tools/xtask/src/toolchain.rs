//! Which compiler builds for the Cortex-M7.
//!
//! 1. The target of the compiler in use, if it is installed.
//! 2. Else rustup installs it.
//! 3. Else, or where the environment variable `SLIPSENSE_TOOLCHAIN` is `debian`: Debian's compiler, which
//!    builds the `core` library from Debian's sources. It has a target directory of its own, because its
//!    version differs.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

use anyhow::{Result, bail};

use crate::process::{answer, apt_install, cargo, command, find, lock, run, target_dir};

/// The Cortex-M7 with double-precision FPU.
pub const TARGET: &str = "thumbv7em-none-eabihf";
const VARIABLE: &str = "SLIPSENSE_TOOLCHAIN";
const DEBIAN_PACKAGES: [&str; 4] = ["rustc-web", "cargo-web", "rust-web-src", "lld"];

/// A compiler for [`TARGET`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Toolchain {
    /// The one that built this program.
    Host,
    /// Debian's packages.
    Debian,
}

impl Toolchain {
    /// Find or install one. Decided once per run.
    pub fn get() -> Result<Self> {
        static DECIDED: OnceLock<Toolchain> = OnceLock::new();
        match DECIDED.get() {
            Some(&toolchain) => Ok(toolchain),
            None => decide().map(|toolchain| *DECIDED.get_or_init(|| toolchain)),
        }
    }

    /// `cargo build` or another command for the target, with the profile for the board and warnings denied. The
    /// compiler lists what each function takes of the stack, which leaves the code as it is; it calls the option
    /// unstable, hence the permission. All builds have the same flags, so that they share their dependencies.
    pub fn cargo(self, subcommand: &str) -> Command {
        self.cargo_in(subcommand, &self.target_dir(), &[])
    }

    /// The same into another folder, with more flags of the compiler.
    pub fn cargo_in(self, subcommand: &str, target_dir: &Path, flags: &[String]) -> Command {
        let mut build = match self {
            Self::Host => cargo(),
            Self::Debian => command("/usr/bin/cargo"),
        };
        build.env("RUSTC_BOOTSTRAP", "1");
        build.args([subcommand, "--profile", "firmware", "--target", TARGET, "--target-dir"]);
        build.arg(target_dir);
        // Adds to the flags in .cargo/config.toml; the variable RUSTFLAGS would replace them. Names of functions
        // are looked up in the program, so every compiler has to write them the same way.
        let ours = ["-Dwarnings", "-Csymbol-mangling-version=v0", "-Zemit-stack-sizes"].map(str::to_owned);
        build.args(["--config", &format!("target.{TARGET}.rustflags={:?}", [&ours, flags].concat())]);
        if self == Self::Debian {
            build.env("RUSTC", "/usr/bin/rustc").env("CARGO_TARGET_THUMBV7EM_NONE_EABIHF_LINKER", "ld.lld");
            build.arg("-Zbuild-std=core");
        }
        build
    }

    /// What its compiler calls itself.
    pub fn version(self) -> Option<String> {
        let mut rustc = if self == Self::Host { host_rustc() } else { command("/usr/bin/rustc") };
        answer(rustc.arg("--version"))
    }

    /// The program of this name that `cargo build` made.
    pub fn program(self, name: &str) -> PathBuf {
        self.target_dir().join(TARGET).join("firmware").join(name)
    }

    fn target_dir(self) -> PathBuf {
        match self {
            Self::Host => target_dir(),
            Self::Debian => target_dir().join("debian-thumb"),
        }
    }
}

fn decide() -> Result<Toolchain> {
    // Steps of the test command would install the same at the same time.
    let _lock = lock("toolchain")?;
    match std::env::var(VARIABLE).as_deref() {
        Err(_) | Ok("") => {}
        Ok("debian") => return debian(&format!("{VARIABLE} asks for it")),
        Ok(other) => bail!("{VARIABLE} is `{other}`; it may be `debian` or unset"),
    }
    if is_installed() {
        return Ok(Toolchain::Host);
    }
    if find("rustup").is_some() {
        eprintln!("ARM compiler: rustup adds the target {TARGET}");
        let mut rustup = command("rustup");
        rustup.args(["target", "add", TARGET]);
        if let Some(toolchain) = std::env::var_os("RUSTUP_TOOLCHAIN") {
            rustup.env("RUSTUP_TOOLCHAIN", toolchain);
        }
        match run(&mut rustup) {
            Ok(()) => return Ok(Toolchain::Host),
            Err(error) => eprintln!("rustup cannot: {error}"),
        }
    }
    debian("the target is not installed and rustup cannot add it")
}

fn host_rustc() -> Command {
    let mut rustc = command("rustc");
    if let Some(toolchain) = std::env::var_os("RUSTUP_TOOLCHAIN") {
        rustc.env("RUSTUP_TOOLCHAIN", toolchain);
    }
    rustc
}

fn is_installed() -> bool {
    let libdir = answer(host_rustc().args(["--print", "target-libdir", "--target", TARGET]));
    let holds_core = |dir: &Path| {
        let names = dir.read_dir().into_iter().flatten().flatten();
        names.map(|entry| entry.file_name()).any(|name| name.to_string_lossy().starts_with("libcore-"))
    };
    libdir.is_some_and(|dir| holds_core(Path::new(&dir)))
}

fn debian(why: &str) -> Result<Toolchain> {
    if !debian_is_complete() {
        apt_install(&DEBIAN_PACKAGES, "building for the Cortex-M7 with Debian's compiler")?;
    }
    if !debian_is_complete() {
        bail!(
            "Debian's compiler is incomplete: {} are installed, yet core is missing",
            DEBIAN_PACKAGES.join(" ")
        );
    }
    let version = Toolchain::Debian.version().unwrap_or_default();
    eprintln!("ARM compiler: Debian's {version}, {why}");
    Ok(Toolchain::Debian)
}

fn debian_is_complete() -> bool {
    let sources = Path::new("/usr/lib/rustlib/src/rust/library/core/src/lib.rs");
    let programs = ["/usr/bin/rustc", "/usr/bin/cargo"].map(Path::new);
    programs.iter().all(|program| program.exists()) && sources.exists() && find("ld.lld").is_some()
}
