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
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use clap::Args;

use crate::process::{cargo, command, run as start, target_dir};
use crate::twin::synthetic_pull;
use packages::EMULATOR;

/// Traffic in the test command, s.
const STEP_SECONDS: u32 = 4;
/// Sensors on the bus.
const SENSORS: usize = 3;
/// Memory of the emulated computer, MB: its files are in it.
const MEMORY_MB: u64 = 3072;
/// Nobody waits longer for the emulator, per second of traffic and at all.
const PATIENCE: [Duration; 2] = [Duration::from_secs(60), Duration::from_secs(600)];
/// Between two looks at the emulator.
const LOOK: Duration = Duration::from_millis(200);

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

/// In the test command.
pub fn step() -> Result<()> {
    match run(&Options { seconds: STEP_SECONDS })? {
        true => Ok(()),
        false => bail!("SocketCAN on Linux: see the table"),
    }
}

/// `false`: something is not as it should be.
pub fn run(options: &Options) -> Result<bool> {
    let dir = target_dir().join("linux");
    fs::create_dir_all(&dir).with_context(|| dir.display().to_string())?;
    let debian = packages::debian(&target_dir().join("tools/debian"))?;
    start(cargo().args(["build", "--release", "--quiet", "--package", "slipsense-cli"]))?;
    let slipsense = target_dir().join("release/slipsense");
    let share = dir.join("share");
    if share.exists() {
        fs::remove_dir_all(&share).with_context(|| share.display().to_string())?;
    }
    fs::create_dir(&share).with_context(|| share.display().to_string())?;
    let episode = synthetic_pull("tesollo", SENSORS, options.seconds)?;
    start(command(&slipsense).arg("convert").arg(episode).arg(share.join(checks::SENT)))?;
    let root = dir.join("initramfs");
    initramfs::write(&root, &debian, &slipsense)?;
    let console = dir.join("console.log");
    let began = Instant::now();
    eprintln!(
        "{} boots in {EMULATOR}, {} s of traffic; it says {}",
        debian.name,
        options.seconds,
        console.display()
    );
    boot(&debian.kernel, &root, &share, &console, options.seconds)?;
    let end = fs::read_to_string(share.join("end"));
    ensure!(end.is_ok(), "the emulated computer did not come to the end: {}", console.display());
    checks::report(&share, &slipsense, options.seconds, began.elapsed())
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
    let mut child = child.with_context(|| format!("cannot start {EMULATOR}"))?;
    let limit = PATIENCE[0] * seconds + PATIENCE[1];
    let ended = wait(&mut child, limit);
    if ended.is_err() {
        // Whatever was wrong with waiting: nothing of it may stay behind.
        let _ = child.kill();
        child.wait()?;
    }
    ended.with_context(|| console.display().to_string())
}

fn wait(child: &mut Child, limit: Duration) -> Result<()> {
    let began = Instant::now();
    loop {
        if let Some(status) = child.try_wait()? {
            ensure!(status.success(), "{EMULATOR}: {status}");
            return Ok(());
        }
        ensure!(began.elapsed() < limit, "the emulated computer does not end for {} s", limit.as_secs());
        std::thread::sleep(LOOK);
    }
}
