//! Debian's kernel and busybox, unpacked and not installed, and the emulator.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::process::{answer, command, empty_dir, find, is_root, need, run};

/// Always depends on the current kernel with all its modules; the flavour for clouds has no CAN.
const KERNEL: &str = "linux-image-amd64";
const BUSYBOX: &str = "busybox-static";
const EMULATOR_PACKAGE: &str = "qemu-system-x86";
pub const EMULATOR: &str = "qemu-system-x86_64";

pub struct Debian {
    pub kernel: PathBuf,
    /// `/lib/modules/VERSION`.
    pub modules: PathBuf,
    pub busybox: PathBuf,
    /// Name of the kernel's package.
    pub name: String,
}

/// Get what is not in `dir` yet.
pub fn debian(dir: &Path) -> Result<Debian> {
    need(EMULATOR, &[EMULATOR_PACKAGE], "Linux with SocketCAN in an emulator")?;
    ensure!(
        find("apt-get").is_some() && find("dpkg").is_some(),
        "the kernel and busybox come from Debian's packages: this needs a Debian, or a container of one"
    );
    // Of another system's packages there may be lists that do not know this one.
    let current = || {
        // `Depends: linux-image-6.1.0-56-amd64`.
        let text = answer(command("apt-cache").args(["depends", KERNEL]))?;
        text.lines().find_map(|line| line.trim().strip_prefix("Depends: ")).map(str::to_owned)
    };
    let name = match current() {
        Some(name) => name,
        None => {
            update()?;
            current().with_context(|| format!("no package {KERNEL}: this needs Debian for amd64"))?
        }
    };
    let kernel = unpacked(dir, &name)?;
    let version = name.trim_start_matches("linux-image-");
    let busybox = unpacked(dir, BUSYBOX)?.join("bin/busybox");
    let usr = kernel.join("usr");
    // Since 2024 Debian has /lib below /usr.
    let below = |path: &str| [&kernel, &usr].map(|dir| dir.join(path)).into_iter().find(|path| path.exists());
    let missing = || format!("{name}: not unpacked as expected into {}", kernel.display());
    Ok(Debian {
        modules: below(&format!("lib/modules/{version}")).with_context(missing)?,
        busybox: if busybox.exists() { busybox } else { unpacked(dir, BUSYBOX)?.join("usr/bin/busybox") },
        kernel: kernel.join(format!("boot/vmlinuz-{version}")),
        name,
    })
}

fn update() -> Result<()> {
    ensure!(is_root(), "apt knows no package {KERNEL}: sudo apt-get update");
    run(command("apt-get").args(["update", "--quiet"]))
}

fn unpacked(dir: &Path, package: &str) -> Result<PathBuf> {
    let files = dir.join(package);
    if files.exists() {
        return Ok(files);
    }
    let partial = empty_dir(dir.join(format!("{package}.partial")))?;
    let download = || run(command("apt-get").args(["download", "--quiet", package]).current_dir(&partial));
    if download().is_err() {
        // Lists of packages age: the version that they name is gone.
        update()?;
        download()?;
    }
    let archive = fs::read_dir(&partial)?.next().with_context(|| format!("{package}: not downloaded"))??;
    run(command("dpkg").arg("--extract").arg(archive.path()).arg(partial.join("files")))?;
    fs::rename(partial.join("files"), &files).with_context(|| files.display().to_string())?;
    fs::remove_dir_all(&partial).with_context(|| partial.display().to_string())?;
    Ok(files)
}
