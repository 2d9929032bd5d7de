//! The board twin: builds the firmware as it is flashed and `tests/twin`, and runs the one in the other.

pub mod machine;
pub mod update;

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail, ensure};

use crate::firmware::Program;
use crate::process::{DEMO_EPISODE, Running, command, root, run as start, script, small_cli, target_dir};
use machine::{MODEL, synthetic_pull, twin_with, with_far_end};

/// Frames of the demo that go through the mailbox, and virtual time that is more than they need: while the program
/// waits for the next one, it flies.
const HIL_FRAMES: &str = "60";
const HIL_SECONDS: &str = "36000";
/// The accelerometer of the default firmware; another one needs a firmware of its own.
const DEFAULT_XL: &str = "adxl380";
const OTHER_XL: &str = "icm42688";
/// Virtual seconds of a long run, and what it plays with two sensors where someone has it: a pull, composed of real
/// recordings. Else a synthetic one.
const LONG_SECONDS: u32 = 20;
const REAL_PULL: &str = "../shared/real/slip_up.npz";
/// Virtual seconds with three sensors in the test command.
const REAL_TIME_S: u32 = 6;
/// Once more while the pads are pressed: a full bus, then destroyed frames.
const BUSY_BUS: [&str; 4] = ["--fault", "flood:2.5-4", "--fault", "errors10:4.2-5.7"];
const LOOPBACK_PASSED: &str = "loop back passed";

/// Run the firmware's ELF on an emulated STM32H743, in virtual time
#[derive(clap::Args)]
#[command(after_help = "Examples:
  cargo xtask twin                                         one virtual second without sensors
  cargo xtask twin host-tools/cli/demo/episode.npz         play an episode through the sensors
  cargo xtask twin EPISODE.npz --xl icm42688               with that accelerometer and the firmware for it
  cargo xtask twin --seconds 3 --fault off:0.5-1.5       nobody acknowledges for a second
  cargo xtask twin EPISODE.npz --faults                    every fault in turn, and a table of flags and recovery
  cargo xtask twin EPISODE.npz --faults --seconds 3600     the same, over and over
  cargo xtask twin --long                                  20 s each: two sensors, three, two ICM-42688-P
  cargo xtask twin --updates                               updates over the bus, the supply fails again and again
  cargo xtask twin --flash-flags                           500 stores and updates, flags of reads at random
  cargo xtask twin EPISODE.npz --bit-flips 1000            a bit of a register or of RAM flips: what the receiver finds
  cargo xtask twin EPISODE.npz --bit-flips 1000 --results FILE   the same, and it can be stopped and go on
  cargo xtask twin --boot-skips 5000                       the bootloader, with one instruction skipped
  cargo xtask twin --gdb 3333                              wait for a debugger on this port
All options: cargo xtask twin --help, then what `slipsense-twin --help` says")]
pub struct Options {
    /// The runs that take minutes: 20 virtual seconds with two sensors, with three, and with two ICM-42688-P
    #[arg(long, exclusive = true)]
    long: bool,
    /// The step `twin-update` with more failures of the supply: at every step of a store, and at more of the others
    #[arg(long, exclusive = true)]
    updates: bool,
    /// 500 stores and updates while the flash raises flags of reads; in the step `twin-faults` there are 13
    #[arg(long, exclusive = true)]
    flash_flags: bool,
    /// The bootloader must refuse two images; so many times for each it skips one of its instructions. In the step
    /// `twin-boot` 20 times; 20000 is every instruction
    #[arg(long, value_name = "RUNS", exclusive = true)]
    boot_skips: Option<u32>,
    /// What the twin is given: episode and options
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

pub fn run(options: &Options) -> Result<bool> {
    match options {
        Options { long: true, .. } => return long(),
        Options { updates: true, .. } => update::step(&small_cli()?, true)?,
        Options { flash_flags: true, .. } => update::faults(&small_cli()?, "500")?,
        Options { boot_skips: Some(count), .. } => update::boot_skips(&small_cli()?, *count)?,
        Options { arguments, .. } => {
            return Ok(twin(accelerometer(arguments))?.args(arguments).status()?.success());
        }
    }
    Ok(true)
}

fn accelerometer(arguments: &[String]) -> &str {
    let after = arguments.iter().skip_while(|argument| *argument != "--xl").nth(1);
    let within = arguments.iter().find_map(|argument| argument.strip_prefix("--xl="));
    within.or(after.map(String::as_str)).unwrap_or(DEFAULT_XL)
}

fn twin(xl: &str) -> Result<Command> {
    twin_with(&if xl == OTHER_XL { Program::ICM42688 } else { Program::FIRMWARE }.build()?)
}

/// 20 s each, too long for the test command.
fn long() -> Result<bool> {
    let slipsense = small_cli()?;
    let real = root().join(REAL_PULL);
    let two = if real.exists() { real } else { synthetic_pull(&slipsense, "umi", 2, LONG_SECONDS)? };
    let three = synthetic_pull(&slipsense, "tesollo", 3, LONG_SECONDS)?;
    let runs = [("2", &two, DEFAULT_XL), ("3", &three, DEFAULT_XL), ("2", &two, OTHER_XL)];
    let mut good = true;
    for (sensors, episode, xl) in runs {
        println!("\n{sensors} sensors, {xl}: {LONG_SECONDS} s of {}", episode.display());
        let mut run = twin(xl)?;
        run.arg(episode).args(["--xl", xl, "--sensors", sensors, "--seconds", &LONG_SECONDS.to_string()]);
        good &= run.status()?.success();
    }
    Ok(good)
}

/// embassy's driver in loop back; without sensors; the demo episode, with either accelerometer; three sensors in real
/// time, on a free and on a busy bus; and that the scan computed where somebody looks is the scan event by event.
pub fn step(slipsense: &Path) -> Result<()> {
    let mut loopback = twin_with(&Program::CAN_LOOPBACK.build()?)?;
    start(loopback.args(["--seconds", "0.2", "--says", LOOPBACK_PASSED]))?;
    start(twin(DEFAULT_XL)?.args(["--seconds", "0.2"]))?;
    let episode = root().join(DEMO_EPISODE);
    for xl in [DEFAULT_XL, OTHER_XL] {
        start(twin(xl)?.arg(&episode).args(["--xl", xl, "--seconds", "1"]))?;
    }
    let three = synthetic_pull(slipsense, "tesollo", 3, REAL_TIME_S)?;
    for faults in [&[][..], &BUSY_BUS] {
        let mut run = twin(DEFAULT_XL)?;
        start(run.arg(&three).args(["--sensors", "3", "--seconds", &REAL_TIME_S.to_string()]).args(faults))?;
    }
    let traced = |name: &str, slow: Option<&str>| {
        let path = target_dir().join(name);
        let mut run = twin(DEFAULT_XL)?;
        start(run.arg(&episode).args(["--seconds", "0.16", "--trace"]).arg(&path).args(slow))?;
        std::fs::read(&path).with_context(|| path.display().to_string())
    };
    let (fast, slow) = (traced("fast.trace", None)?, traced("slow.trace", Some("--slow"))?);
    ensure!(fast == slow, "the twin with --slow does not do what it does without");
    Ok(())
}

/// Faults of wires and parts on the desk, as the twin calls them, how many checks of two sensors must fail of each, and
/// what the first has to say.
const DESK_FAULTS: [(&str, usize, &str); 22] = [
    ("hse-absent", 1, "clock: no clock on PH0"),
    ("hse-off", 1, "clock: PH0 has 8080000 Hz"),
    ("hse-wrong", 1, "clock: PH0 has 16000000 Hz"),
    ("no-transceiver", 1, "CAN transceiver: RX (PD0) does not follow TX (PD1)"),
    ("line-at-ground", 1, "address pins: column A3 (PE5) is held at ground"),
    ("lines-shorted", 1, "address pins: column A1 (PE3) and column A2 (PE4) are shorted"),
    ("line-open", 2, "array 0: row A2 (PE9) changes nothing"),
    ("lines-swapped", 2, "array 0: column A2 (PE4) and column A3 (PE5) are swapped"),
    ("row-open", 1, "array 0: row 11 stays idle"),
    ("column-high", 1, "array 0: column 20 at full scale"),
    ("unplugged", 1, "array 0: all codes at full scale"),
    ("array-shorted", 1, "array 0: all codes at 0"),
    ("taxel-dead", 1, "array 0: 1 taxels idle among pressed ones, the first at row 9 column 13"),
    ("taxel-stuck", 1, "array 0: 1 taxels without any noise, the first at row 9 column 13"),
    ("taxel-noisy", 1, "array 0: 1 taxels noisy"),
    ("slow", 1, "settling 0: "),
    ("miso-open", 2, "accelerometer 0: its identifier reads all ones: MISO (PA6)"),
    ("select-open", 1, "accelerometer 0: its identifier reads all ones: its chip select or supply"),
    ("xl-wrong", 1, "accelerometer 0: identifier 0xad17c080, expected 0xad17c000"),
    ("xl-frozen", 1, "accelerometer 0: all samples are equal"),
    ("xl-slow", 1, "accelerometer 0: 7"),
    ("xl-stops", 1, "accelerometer 0: answers, but samples nothing"),
];
/// The bring-up program is through before.
const DESK_SECONDS: &str = "0.6";

/// The bring-up program on a sound board, then with one fault of a wire or part after the other.
pub fn bringup_step() -> Result<()> {
    let program = Program::BRINGUP.build()?;
    let sound = [(None, "verdict: OK, 1 not judged".to_owned())];
    let faults = DESK_FAULTS.map(|(fault, failed, first)| {
        (Some(fault), format!("verdict: {failed} failed, the first: FAILED {first}"))
    });
    for (fault, verdict) in sound.into_iter().chain(faults) {
        let mut desk = twin_with(&program)?;
        desk.args(["--desk", "2", "--seconds", DESK_SECONDS]);
        desk.args(fault.map(|fault| ["--desk-fault", fault]).into_iter().flatten());
        start(desk.args(["--says", &verdict]))?;
    }
    Ok(())
}

/// Every fault of bus and sensors in turn, then those of the board itself.
pub fn faults_step(slipsense: &Path) -> Result<()> {
    start(twin(DEFAULT_XL)?.arg(root().join(DEMO_EPISODE)).arg("--faults"))?;
    update::faults(slipsense, "13")
}

/// pycyphal talks to the node of the firmware, through the modelled bus.
pub fn node_step() -> Result<()> {
    let twin = twin_with(&Program::FIRMWARE.build()?)?;
    with_far_end(twin, |port| start(script("check_twin_node.py")?.arg(port).arg(MODEL)))
}

/// `slipsense hil`, with the program that it has on a board on the emulated STM32H743.
pub fn hil_step(slipsense: &Path) -> Result<()> {
    let program = Program::HIL.build()?;
    let mut twin = twin_with(&program)?;
    twin.args(["--gdb", "0", "--seconds", HIL_SECONDS]);
    let mut twin = Running(twin.stderr(Stdio::piped()).spawn().context("cannot start the twin")?);
    // Kept until the end: the twin may write more.
    let mut output = BufReader::new(twin.0.stderr.take().context("the twin has a standard error")?);
    let mut first = String::new();
    output.read_line(&mut first)?;
    let address = first.trim().rsplit_once(' ').filter(|_| first.starts_with("waiting for a debugger"));
    let Some((_, address)) = address else { bail!("the twin serves no debugger: {first}") };
    let mut hil = command(slipsense);
    hil.args(["hil", DEMO_EPISODE, "--elf"]).arg(&program);
    start(hil.args(["--frames", HIL_FRAMES, "--timeout-s", "60", "--gdb", address]))
}
