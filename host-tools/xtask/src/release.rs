//! `cargo xtask release`: what a release holds, the same bytes from the same commit and compilers in any folder.
//!
//! The compilers write no path of this computer into what they build, all times are the commit's, and archives list
//! files in a fixed order. The folder appears when everything in it is made.

mod sbom;

use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use clap::Args;
use ed25519_dalek::SigningKey;
use slipsense::update::DEVELOPMENT_SEED;
use slipsense_recording::{from_hex, hex};

use crate::firmware::{FEATURE, NAME};
use crate::process::{answer, cargo, command, empty_dir, git, python, root, run, target_dir};
use crate::toolchain::{TARGET, Toolchain};
use crate::web;

/// Everybody's version: the workspace's.
const VERSION: &str = env!("CARGO_PKG_VERSION");
const CHANGELOG: &str = "CHANGELOG.md";
const MODEL: &str = "model/weights/slipsense.slipnet";
const BOOTLOADER: &str = "slipsense-boot";
/// A firmware for each accelerometer, and the features that select it.
const ACCELEROMETERS: [(&str, &str); 3] =
    [("adxl380", "h743"), ("adxl382", "h743,adxl382"), ("icm42688", "h743,icm42688")];

/// Make what a release holds, from a clean commit
#[derive(Args)]
#[command(after_help = "\
DIR gets the command for Linux, the Python wheel, the live page as one file, signed images of firmware and model, the ELF files that a debug
probe writes, a bill of materials (CycloneDX), the changelog, and SHA256SUMS of all. The same commit and compilers
give the same bytes in any folder; the bill of materials names both.

Refused: changes that are not committed, a version that CHANGELOG.md does not have, the development key, and a folder
that is not empty.

Example:
  slipsense keygen --out fleet.key                         once; keep it
  cargo xtask release --key fleet.key --out out/release
  cd out/release && sha256sum --check SHA256SUMS")]
pub struct Options {
    /// Private key that signs firmware and model, from `slipsense keygen`
    #[arg(long, value_name = "FILE")]
    key: PathBuf,
    /// Folder to make
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn make(options: &Options) -> Result<()> {
    let (key, out, begun) = (read_key(&options.key)?, std::path::absolute(&options.out)?, Instant::now());
    check_folder(&out)?;
    check_changelog(&fs::read_to_string(root().join(CHANGELOG)).context(CHANGELOG)?)?;
    check_tree(&git(&["status", "--porcelain"])?)?;
    let parent = out.parent().context("--out: must be a folder")?;
    fs::create_dir_all(parent).with_context(|| parent.display().to_string())?;
    let made = tempfile::Builder::new().prefix(".slipsense-").suffix(".partial").tempdir_in(parent)?;
    let build = Build::new(hex(key.verifying_key().as_bytes()), made.path())?;

    let bill = made.path().join(format!("slipsense-{VERSION}.cdx.json"));
    let time = git(&["log", "-1", "--date=iso-strict-local", "--format=%cd"])?;
    sbom::write(&bill, &git(&["rev-parse", "HEAD"])?, &time)?;
    let slipsense = build.command()?;
    build.wheel(&bill)?;
    build.page()?;
    let key = std::path::absolute(&options.key)?;
    let sign = |file: &Path, image: &str, board: &[&str]| {
        let mut sign = command(&slipsense);
        sign.arg("sign").arg(file).args(board).args(["--version", VERSION, "--key"]).arg(&key);
        run(sign.arg("--out").arg(made.path().join(format!("{image}-{VERSION}.slip"))))
    };
    sign(&root().join(MODEL), "model", &[])?;
    for (part, features) in ACCELEROMETERS {
        let program = build.program(NAME, features)?;
        sign(&program, &format!("firmware-{part}"), &["--board", FEATURE])?;
        build.keep(&program, &format!("{NAME}-{part}-{VERSION}.elf"))?;
    }
    build.keep(&build.program(BOOTLOADER, FEATURE)?, &format!("{BOOTLOADER}-{VERSION}.elf"))?;
    build.keep(&root().join(CHANGELOG), CHANGELOG)?;
    let files = sums(made.path())?;
    if out.exists() {
        fs::remove_dir(&out)?;
    }
    fs::rename(made.path(), &out).with_context(|| format!("{}: cannot write", out.display()))?;
    println!("{}: {files} files in {:.0} s", out.display(), begun.elapsed().as_secs_f64());
    println!("public key {}", build.public_key);
    Ok(())
}

/// The part of the test command: what needs no build, and no repository of git.
pub fn step() -> Result<()> {
    check_changelog(&fs::read_to_string(root().join(CHANGELOG)).context(CHANGELOG)?)?;
    let bill = empty_dir("release-bill")?.join("slipsense.cdx.json");
    sbom::write(&bill, "none", "1970-01-01T00:00:00+00:00")?;
    let mut lint = command(target_dir().join("venv/bin/zizmor"));
    // In the environment that has just checked the bill.
    run(lint.args(["--offline", "--quiet", "--strict-collection", ".github/workflows"]))
}

fn read_key(path: &Path) -> Result<SigningKey> {
    let name = path.display();
    let text = fs::read_to_string(path).with_context(|| format!("{name}: cannot read the key"))?;
    let seed = from_hex(text.trim()).with_context(|| format!("{name}: a key has 64 hexadecimal digits"))?;
    ensure!(seed != DEVELOPMENT_SEED, "{name}: is the development key, whose private half everybody has");
    Ok(SigningKey::from_bytes(&seed))
}

fn check_folder(out: &Path) -> Result<()> {
    let is_free = !out.exists() || fs::read_dir(out).is_ok_and(|mut entries| entries.next().is_none());
    ensure!(is_free, "{}: is there already; a release is a new folder", out.display());
    Ok(())
}

fn check_changelog(text: &str) -> Result<()> {
    let has = text.lines().any(|line| line.strip_prefix("## ").is_some_and(|rest| rest.trim() == VERSION));
    ensure!(has, "{CHANGELOG}: has no entry `## {VERSION}`");
    Ok(())
}

/// What `git status` says.
fn check_tree(status: &str) -> Result<()> {
    let first = status.lines().next();
    ensure!(first.is_none(), "not committed: {}", first.unwrap_or_default());
    Ok(())
}

/// Write `SHA256SUMS` over the folder's files; how many there are.
fn sums(folder: &Path) -> Result<usize> {
    let entries = fs::read_dir(folder)?;
    let mut names = entries.map(|entry| Ok(entry?.file_name())).collect::<Result<Vec<_>>>()?;
    names.sort();
    let mut sums = command("sha256sum");
    let said =
        answer(sums.current_dir(folder).args(&names)).context("sha256sum: cannot read what was made")?;
    fs::write(folder.join("SHA256SUMS"), said + "\n")?;
    Ok(names.len() + 1)
}

/// How everything is built, beside the daily builds, whose flags differ.
struct Build<'r> {
    public_key: String,
    /// Seconds since 1970 of the commit.
    epoch_s: String,
    /// Flags of the compiler: paths that it writes into what it builds.
    flags: Vec<String>,
    /// The paths that must not be in it.
    paths: Vec<String>,
    target_dir: PathBuf,
    release: &'r Path,
}

impl<'r> Build<'r> {
    fn new(public_key: String, release: &'r Path) -> Result<Self> {
        let source = root().canonicalize()?.display().to_string();
        let home = env::var("CARGO_HOME").or_else(|_| env::var("HOME").map(|home| home + "/.cargo"));
        let home = home.context("HOME: is not set")?;
        let target_dir = target_dir().join("release-build");
        fs::create_dir_all(&target_dir).with_context(|| target_dir.display().to_string())?;
        let target_dir = target_dir.canonicalize()?;
        let mut paths = vec![(source, "/slipsense"), (home, "/cargo")];
        if !target_dir.starts_with(&paths[0].0) {
            paths.push((target_dir.display().to_string(), "/slipsense/target"));
        }
        let flags = paths.iter().map(|(path, to)| format!("--remap-path-prefix={path}={to}")).collect();
        let epoch_s = git(&["log", "-1", "--format=%ct"])?;
        let paths = paths.into_iter().map(|(path, _)| path).collect();
        Ok(Self { public_key, epoch_s, flags, paths, target_dir, release })
    }

    fn environment<'c>(&self, command: &'c mut Command) -> &'c mut Command {
        command.env("SOURCE_DATE_EPOCH", &self.epoch_s).env("CARGO_TARGET_DIR", &self.target_dir);
        command.env("CARGO_ENCODED_RUSTFLAGS", self.flags.join("\x1f"))
    }

    /// `slipsense` for this computer's kind, and the archive with it.
    fn command(&self) -> Result<PathBuf> {
        let mut build = cargo();
        build.args(["rustc", "--quiet", "--locked", "--release"]);
        build.args(["--package", "slipsense-cli", "--bin", "slipsense"]);
        // Names of symbols differ between two builds. The profile cannot strip them: cargo drops that setting where a
        // package has a profile of its own, as this one has.
        build.args(["--features", "train", "--", "-Cstrip=symbols"]);
        run(self.environment(&mut build))?;
        let folder = self.target_dir.join("release");
        check_paths(&folder.join("slipsense"), &self.paths)?;
        let name = format!("slipsense-{VERSION}-{}-linux.tar.gz", env::consts::ARCH);
        let mut tar = command("tar");
        tar.args(["--create", "--gzip", "--format=ustar", "--owner=0", "--group=0", "--numeric-owner"]);
        tar.args(["--mode=u=rwX,go=rX", "--mtime"]).arg(format!("@{}", self.epoch_s)).arg("--file");
        tar.arg(self.release.join(name)).arg("--directory").arg(root());
        run(tar.args(["LICENSE-APACHE", "LICENSE-MIT", "--directory"]).arg(&folder).arg("slipsense"))?;
        Ok(folder.join("slipsense"))
    }

    fn wheel(&self, bill: &Path) -> Result<()> {
        let mut maturin = python()?;
        maturin
            .args(["-m", "maturin", "build", "--release", "--locked", "--quiet", "--sbom-include"])
            .arg(bill);
        maturin.args(["--manifest-path", "host-tools/python/Cargo.toml", "--out"]).arg(self.release);
        run(self.environment(&mut maturin))?;
        check_paths(&self.target_dir.join("release/lib_slipsense.so"), &self.paths)
    }

    /// The live page that needs no server.
    fn page(&self) -> Result<()> {
        let page = self.release.join(format!("slipsense-{VERSION}.html"));
        web::make_in(&page, &self.target_dir.join("web"), &self.flags)?;
        check_paths(&page, &self.paths)
    }

    /// A program of the board, which believes the release's key.
    fn program(&self, name: &str, features: &str) -> Result<PathBuf> {
        // Its compiler may be another one.
        let target_dir = self.target_dir.join("board");
        let mut build = Toolchain::get()?.cargo_in(TARGET, "build", &target_dir, &self.flags);
        build.args(["--locked", "--package", "slipsense", "--bin", name, "--features", features]);
        build.env("SLIPSENSE_RELEASE", "1").env("SLIPSENSE_UPDATE_KEY", &self.public_key);
        run(build.env_remove("SLIPSENSE_UPDATE_KEY_NEXT"))?;
        Ok(target_dir.join(TARGET).join("firmware").join(name))
    }

    fn keep(&self, file: &Path, name: &str) -> Result<()> {
        check_paths(file, &self.paths)?;
        fs::copy(file, self.release.join(name)).map(|_| ()).with_context(|| file.display().to_string())
    }
}

/// A path of this computer in a file makes it differ in another folder.
fn check_paths(file: &Path, paths: &[String]) -> Result<()> {
    let (name, bytes) = (file.display(), fs::read(file).with_context(|| file.display().to_string())?);
    for path in paths {
        let is_in = bytes.windows(path.len()).any(|window| window == path.as_bytes());
        ensure!(!is_in, "{name}: holds the path {path}, so another folder would give other bytes");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal<T>(result: Result<T>) -> String {
        format!("{:#}", result.err().expect("refused"))
    }

    #[test]
    fn what_is_no_release_is_refused_in_one_line() {
        let dir = tempfile::tempdir().unwrap();
        let key = dir.path().join("fleet.key");
        assert!(refusal(read_key(&key)).contains("fleet.key: cannot read the key"));
        fs::write(&key, "12").unwrap();
        assert!(refusal(read_key(&key)).contains("fleet.key: a key has 64 hexadecimal digits"));
        fs::write(&key, hex(&DEVELOPMENT_SEED)).unwrap();
        assert!(refusal(read_key(&key)).contains("fleet.key: is the development key"));
        fs::write(&key, hex(&[7; 32]) + "\n").unwrap();
        assert!(read_key(&key).is_ok());

        assert!(refusal(check_folder(dir.path())).contains("is there already"));
        assert!(refusal(check_folder(&key)).contains("is there already"));
        assert!(check_folder(&dir.path().join("new")).is_ok());

        assert_eq!(refusal(check_tree("M src/lib.rs\n?? new")), "not committed: M src/lib.rs");
        assert!(check_tree("").is_ok());
        assert!(refusal(check_changelog("## 0.0.1\n")).contains(CHANGELOG));
        assert!(check_changelog(include_str!("../../../CHANGELOG.md")).is_ok(), "no entry of {VERSION}");
    }

    #[test]
    fn a_path_of_this_computer_is_found() {
        let dir = tempfile::tempdir().unwrap();
        let paths = ["/home/me/slipsense".to_owned()];
        let file = dir.path().join("program");
        fs::write(&file, b"\x7fELF\0/slipsense/src/lib.rs\0").unwrap();
        assert!(check_paths(&file, &paths).is_ok());
        fs::write(&file, b"\x7fELF\0/home/me/slipsense/src/lib.rs\0").unwrap();
        assert!(refusal(check_paths(&file, &paths)).contains("program: holds the path /home/me/slipsense"));
    }

    #[test]
    fn sums_are_of_all_files_by_name() {
        let dir = tempfile::tempdir().unwrap();
        fs::write(dir.path().join("b"), "abc").unwrap();
        fs::write(dir.path().join("a"), "").unwrap();
        assert_eq!(sums(dir.path()).unwrap(), 3);
        // FIPS 180-4 examples.
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad  b\n";
        let empty = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855  a\n";
        assert_eq!(fs::read_to_string(dir.path().join("SHA256SUMS")).unwrap(), format!("{empty}{abc}"));
    }
}
