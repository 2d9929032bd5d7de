//! Other programs: started in the repository's root, with an environment of their own.

use std::env;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::root;

/// What `cargo run` adds to the environment. A cargo started from here must not see it: build scripts
/// would run again, and Debian's cargo would be handed rustup's compiler and libraries.
const OURS: [&str; 7] =
    ["CARGO", "RUSTUP_TOOLCHAIN", "RUST_RECURSION_COUNT", "RUSTC", "RUSTDOC", "LD_LIBRARY_PATH", "OUT_DIR"];
const OURS_PREFIX: [&str; 4] = ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_"];

/// A program, to be started in the root.
pub fn command(program: impl AsRef<std::ffi::OsStr>) -> Command {
    let mut command = Command::new(program);
    command.current_dir(root());
    for (name, _) in env::vars_os() {
        let Some(text) = name.to_str() else { continue };
        if OURS.contains(&text) || OURS_PREFIX.iter().any(|prefix| text.starts_with(prefix)) {
            command.env_remove(&name);
        }
    }
    command
}

/// The cargo that started us, with its toolchain.
pub fn cargo() -> Command {
    let mut cargo = command(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    for name in ["RUSTUP_TOOLCHAIN", "LD_LIBRARY_PATH"] {
        if let Some(value) = env::var_os(name) {
            cargo.env(name, value);
        }
    }
    cargo
}

/// Where cargo puts what it builds.
pub fn target_dir() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |dir| root().join(dir))
}

/// Print the command line, run it, fail if it fails. Its output goes where ours does; what it prints on
/// standard output goes to standard error, which leaves ours to results.
pub fn run(command: &mut Command) -> Result<()> {
    let line = describe(command);
    eprintln!("$ {line}");
    let stderr = std::io::stderr();
    let status =
        command.stdout(Stdio::from(stderr)).status().with_context(|| format!("cannot start `{line}`"))?;
    if !status.success() {
        bail!("`{line}` failed: {status}");
    }
    Ok(())
}

/// Standard output of a program that only tells something; `None` if it cannot be started or fails.
pub fn answer(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Is there a program of this name on the PATH?
pub fn find(program: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|dir| dir.join(program)).find(|candidate| candidate.is_file())
}

/// May we install packages?
pub fn is_root() -> bool {
    answer(command("id").arg("-u")).is_some_and(|id| id == "0")
}

/// Install Debian packages, where we may.
pub fn apt_install(packages: &[&str], why: &str) -> Result<()> {
    let list = packages.join(" ");
    if find("apt-get").is_none() || !is_root() {
        bail!("{why} needs the packages `{list}`: install them (on Debian: sudo apt-get install {list})");
    }
    eprintln!("installing {list}: {why} needs them");
    let mut apt = command("apt-get");
    apt.env("DEBIAN_FRONTEND", "noninteractive").args(["update", "--quiet"]);
    run(&mut apt)?;
    let mut apt = command("apt-get");
    apt.env("DEBIAN_FRONTEND", "noninteractive");
    apt.args(["install", "--yes", "--quiet", "--no-install-recommends"]).args(packages);
    run(&mut apt)
}

fn describe(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = program.file_name().unwrap_or(program.as_os_str());
    let words = std::iter::once(name).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}
