//! Linux for real: Debian's kernel with SocketCAN on an emulated PC, and the command on an interface of its.
//!
//! The machine that this runs on may have no CAN, and may not load modules. The kernel has both. It runs in QEMU with
//! `-icount`: one instruction takes a nanosecond of the computer's time, whatever this machine is busy with, so that
//! "in real time" is by a clock that the load here does not change.

mod checks;
mod initramfs;
mod packages;

use std::fs::{self, File};
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use crate::process::{Running, command, empty_dir, run as start, small_cli, target_dir};
use crate::twin::machine::synthetic_pull;
use packages::EMULATOR;

/// Traffic in the test command, s.
const STEP_SECONDS: u32 = 4;
const SENSORS: usize = 3;
/// Memory of the emulated computer, MB: its files are in it.
const MEMORY_MB: u64 = 3072;
/// Time that the emulator may take for each second of traffic, and for the rest.
const TIMEOUT_PER_SECOND: Duration = Duration::from_secs(60);
const TIMEOUT: Duration = Duration::from_secs(600);

/// Boot Debian's kernel in QEMU and record, replay, watch and kill on its SocketCAN
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
Gets Debian's kernel and busybox (apt-get download, not installed) and QEMU. Three sensors with plain raw frames at
240 Hz are replayed to a vcan interface and recorded, the recording is replayed and recorded, and a recorder is killed
in the middle. Frames are compared here, byte by byte. The traffic is synthetic; the emulated computer executes 1,000
million instructions per second of its time.

Examples:
  cargo xtask linux                  60 s of traffic, some minutes
  cargo xtask linux --seconds 4      as the test command does")]
pub struct Options {
    /// Seconds of traffic
    #[arg(long, value_name = "S", default_value_t = 60, value_parser = clap::value_parser!(u32).range(2..=120))]
    seconds: u32,
}

pub fn step(slipsense: &Path) -> Result<()> {
    ensure!(check(slipsense, STEP_SECONDS)?, "SocketCAN on Linux: see the table");
    Ok(())
}

pub fn run(options: &Options) -> Result<bool> {
    check(&small_cli()?, options.seconds)
}

/// `false`: something is not as it should be.
fn check(slipsense: &Path, seconds: u32) -> Result<bool> {
    let share = empty_dir("linux/share")?;
    let dir = target_dir().join("linux");
    let debian = packages::debian(&target_dir().join("tools/debian"))?;
    let episode = synthetic_pull(slipsense, "tesollo", SENSORS, seconds)?;
    start(command(slipsense).arg("convert").arg(episode).arg(share.join(checks::SENT)))?;
    let root = dir.join("initramfs");
    initramfs::write(&root, &debian, slipsense)?;
    let console = dir.join("console.log");
    let began = Instant::now();
    eprintln!(
        "{} boots in {EMULATOR}, {seconds} s of traffic; its console: {}",
        debian.name,
        console.display()
    );
    boot(&debian.kernel, &root, &share, &console, seconds)?;
    let end = fs::read_to_string(share.join("end"));
    ensure!(end.is_ok(), "the emulated computer did not come to the end: {}", console.display());
    checks::report(&share, slipsense, seconds, began.elapsed())
}

fn boot(kernel: &Path, root: &Path, share: &Path, console: &Path, seconds: u32) -> Result<()> {
    let log = File::create(console).with_context(|| console.display().to_string())?;
    let mut qemu = command(EMULATOR);
    qemu.args(["-machine", "q35", "-cpu", "max", "-smp", "1", "-m", &MEMORY_MB.to_string()]);
    qemu.args(["-accel", "tcg", "-icount", "shift=0,sleep=off"]);
    qemu.arg("-kernel").arg(kernel).arg("-initrd").arg(root);
    // Mitigations cost a third of the instructions, against nobody.
    let arguments =
        format!("console=ttyS0 quiet panic=-1 mitigations=off nokaslr no5lvl HALF={}", seconds / 2);
    qemu.args(["-append", &arguments, "-display", "none", "-serial", "stdio", "-monitor", "none"]);
    qemu.args(["-no-reboot", "-nic", "none"]);
    let share = share.to_str().filter(|path| !path.contains(','));
    let share = share.context("the emulator takes no folder with a comma in its path")?;
    qemu.args(["-virtfs", &format!("local,path={share},mount_tag=share,security_model=none")]);
    let both = log.try_clone().context("console")?;
    let child = qemu.stdin(Stdio::null()).stdout(log).stderr(both).spawn();
    let mut child = Running(child.with_context(|| format!("cannot start {EMULATOR}"))?);
    let limit = TIMEOUT_PER_SECOND * seconds + TIMEOUT;
    match child.wait(limit)? {
        Some(status) => ensure!(status.success(), "{EMULATOR}: {status}: {}", console.display()),
        None => bail!("{} s are over for the emulated computer: {}", limit.as_secs(), console.display()),
    }
    Ok(())
}
