//! Other programs: started in the repository's root, with an environment of their own.

use std::env;
use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};

/// What `cargo run` adds to the environment. A cargo started from here must not see it: build scripts
/// would run again, and Debian's cargo would be handed rustup's compiler and libraries.
const OURS: [&str; 7] =
    ["CARGO", "RUSTUP_TOOLCHAIN", "RUST_RECURSION_COUNT", "RUSTC", "RUSTDOC", "LD_LIBRARY_PATH", "OUT_DIR"];
const OURS_PREFIX: [&str; 4] = ["CARGO_PKG_", "CARGO_MANIFEST_", "CARGO_BIN_", "CARGO_CRATE_"];
pub const DEMO_EPISODE: &str = "host-tools/cli/demo/episode.npz";
const REQUIREMENTS: &str = "tests/python/requirements.txt";
/// Installs what pip would, in a quarter of the time.
const INSTALLER: &str = "uv==0.13.9";

pub fn root() -> &'static Path {
    // This package lies two folders below it.
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../.."))
}

/// A program, to be started in the root.
pub fn command(program: impl AsRef<OsStr>) -> Command {
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
    let mut cargo = of_our_toolchain(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.envs(env::var_os("LD_LIBRARY_PATH").map(|value| ("LD_LIBRARY_PATH", value)));
    cargo
}

/// The same command, but a cargo that it is or starts lints each crate of the workspace where it compiles it. What the
/// steps of the test command share has to be built like this: to cargo, another compiler is another build.
pub fn with_lints(mut command: Command) -> Command {
    let compiler = concat!(env!("CARGO_MANIFEST_DIR"), "/compile_and_lint");
    command.env("RUSTC_WORKSPACE_WRAPPER", compiler);
    command
}

/// A program that takes the toolchain of the cargo that started us.
pub fn of_our_toolchain(program: impl AsRef<OsStr>) -> Command {
    let mut command = command(program);
    command.envs(env::var_os("RUSTUP_TOOLCHAIN").map(|value| ("RUSTUP_TOOLCHAIN", value)));
    command
}

/// The program `slipsense`, built as by a user's first command: without the trainer.
pub fn small_cli() -> Result<PathBuf> {
    run(cargo().args(["build", "--release", "--quiet", "--package", "slipsense-cli"]))?;
    Ok(target_dir().join("release/slipsense"))
}

/// Where cargo puts what it builds.
pub fn target_dir() -> PathBuf {
    env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |dir| root().join(dir))
}

/// An empty folder at this path, seen from [`target_dir`].
pub fn empty_dir(path: impl AsRef<Path>) -> Result<PathBuf> {
    let dir = target_dir().join(path);
    if dir.exists() {
        fs::remove_dir_all(&dir).with_context(|| dir.display().to_string())?;
    }
    fs::create_dir_all(&dir).with_context(|| dir.display().to_string())?;
    Ok(dir)
}

/// Wait until no other process of ours holds the lock of this name. It is held until the file is dropped: steps of
/// the test command run at the same time, and share what they install and build.
pub fn lock(name: &str) -> Result<File> {
    let path = target_dir().join(format!("{name}.lock"));
    fs::create_dir_all(target_dir())?;
    let file = File::create(&path).with_context(|| path.display().to_string())?;
    file.lock().with_context(|| path.display().to_string())?;
    Ok(file)
}

/// Print the command line, run it, fail if it fails. Its output goes where ours does; what it prints on
/// standard output goes to standard error, which leaves ours to results.
pub fn run(command: &mut Command) -> Result<()> {
    let line = describe(command);
    eprintln!("$ {line}");
    let stderr = std::io::stderr();
    let status =
        command.stdout(Stdio::from(stderr)).status().with_context(|| format!("cannot start `{line}`"))?;
    ensure!(status.success(), "`{line}` failed: {status}");
    Ok(())
}

/// Standard output of a program; `None` if it cannot be started or fails.
pub fn answer(command: &mut Command) -> Option<String> {
    let output = command.stderr(Stdio::null()).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// What git answers; times are UTC.
pub fn git(arguments: &[&str]) -> Result<String> {
    let answer = answer(command("git").env("TZ", "UTC0").args(arguments));
    answer.with_context(|| format!("git {}: needs git and its repository", arguments.join(" ")))
}

/// A program that is stopped when it is not needed any more.
pub struct Running(pub Child);

impl Running {
    /// `None`: it did not end in time, and is stopped.
    pub fn wait(&mut self, limit: Duration) -> Result<Option<ExitStatus>> {
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if let Some(status) = self.0.try_wait()? {
                return Ok(Some(status));
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(None)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

pub fn find(program: &str) -> Option<PathBuf> {
    let path = env::var_os("PATH")?;
    env::split_paths(&path).map(|dir| dir.join(program)).find(|candidate| candidate.is_file())
}

pub fn is_root() -> bool {
    answer(command("id").arg("-u")).is_some_and(|id| id == "0")
}

/// Install the Debian packages that a program is in, unless it is here.
pub fn need(program: &str, packages: &[&str], why: &str) -> Result<()> {
    if find(program).is_some() { Ok(()) } else { apt_install(packages, why) }
}

/// Install Debian packages, where we may.
pub fn apt_install(packages: &[&str], why: &str) -> Result<()> {
    let list = packages.join(" ");
    ensure!(
        find("apt-get").is_some() && is_root(),
        "{why} needs the packages `{list}`: install them (on Debian: sudo apt-get install {list})"
    );
    eprintln!("installing {list}: {why} needs them");
    let _lock = lock("apt")?;
    let apt = |arguments: &[&str]| {
        let mut apt = command("apt-get");
        apt.env("DEBIAN_FRONTEND", "noninteractive").args(arguments);
        apt
    };
    run(&mut apt(&["update", "--quiet"]))?;
    run(apt(&["install", "--yes", "--quiet", "--no-install-recommends"]).args(packages))
}

pub fn script(name: &str) -> Result<Command> {
    let mut script = python()?;
    script.arg(format!("tests/python/{name}"));
    Ok(script)
}

/// `python` in an environment with the packages of [`REQUIREMENTS`].
pub fn python() -> Result<Command> {
    python_with("venv", REQUIREMENTS)
}

/// `python` in an environment of this name with the packages of a list; made anew when it changes.
pub fn python_with(name: &str, requirements: &str) -> Result<Command> {
    let _lock = lock(name)?;
    let venv = target_dir().join(name);
    let made_from = venv.join("requirements.txt");
    let wanted = fs::read(root().join(requirements)).with_context(|| requirements.to_owned())?;
    let python = venv.join("bin/python");
    if fs::read(&made_from).ok() != Some(wanted.clone()) {
        if answer(command("python3").args(["-c", "import venv, ensurepip"])).is_none() {
            apt_install(&["python3", "python3-venv"], "checking against Python")?;
        }
        run(command("python3").args(["-m", "venv", "--clear"]).arg(&venv))?;
        let install = |packages: &[&str]| run(command(&python).arg("-m").args(packages));
        install(&["pip", "install", "--quiet", "--disable-pip-version-check", INSTALLER])?;
        install(&["uv", "pip", "install", "--quiet", "--requirements", requirements])?;
        fs::write(&made_from, wanted).with_context(|| made_from.display().to_string())?;
    }
    Ok(command(python))
}

fn describe(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = program.file_name().unwrap_or(program.as_os_str());
    let words = std::iter::once(name).chain(command.get_args());
    words.map(|word| word.to_string_lossy()).collect::<Vec<_>>().join(" ")
}
