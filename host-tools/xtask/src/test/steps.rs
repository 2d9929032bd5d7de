//! The steps, cheapest first where nothing else decides.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Result, bail};

use crate::board::Board;
use crate::process::{answer, apt_install, cargo, command, find, run, target_dir};
use crate::python::python;
use crate::toolchain::Toolchain;
use crate::{cmsis, linux, node, qemu, root, ros2, stack, twin};

/// One step of the test command.
pub struct Step {
    pub name: &'static str,
    pub what: &'static str,
    pub run: fn() -> Result<()>,
}

/// Extreme frames in total, over 1, 2 and 3 sensors.
const EXTREME_FRAMES: u32 = 2000;
/// Networks of random shape, and extreme frames for each.
const RANDOM_MODELS: std::ops::RangeInclusive<u64> = 1..=3;
const RANDOM_MODEL_FRAMES: u32 = 150;
/// The bundled episode, from the root.
pub const DEMO_EPISODE: &str = "host-tools/cli/demo/episode.npz";
/// Random CAN frames that two encoders compare.
const CAN_FRAMES: &str = "20000";
/// Emulated seconds of each real-time run.
const REAL_TIME_S: u32 = 6;
/// Name of the program and of Debian's package.
const BROWSER: &str = "chromium";
/// Recordings that cannot be part of the repository, where someone has them.
const REAL_EPISODES: &str = "../shared/real";

/// All steps, in order.
pub const STEPS: &[Step] = &[
    Step { name: "fmt", what: "formatting", run: || run(cargo().args(["fmt", "--all", "--check"])) },
    Step { name: "clippy", what: "lints of the whole workspace, warnings denied", run: clippy },
    Step { name: "docs", what: "documentation of the library builds without a warning", run: docs },
    Step {
        name: "host",
        what: "host tests of the whole workspace; front end and network print their figures",
        run: host,
    },
    Step {
        name: "arm-library",
        what: "the library for the Cortex-M7, warnings denied",
        run: || arm(&["--package", "slipsense", "--lib"]),
    },
    Step {
        name: "arm-firmware",
        what: "the firmware of every board and for every accelerometer, and the bootloader, warnings denied",
        run: firmware,
    },
    Step {
        name: "stack",
        what: "no board's firmware can outgrow its stack, its memories, 512 KB of flash",
        run: stack::step,
    },
    Step {
        name: "twin",
        what: "the firmware's ELF on an emulated STM32H743: boots, breaks no rule, decides as the host does; with the \
               ICM-42688-P too; embassy's CAN driver in loop back",
        run: twin::step,
    },
    Step {
        name: "twin-faults",
        what: "there, bus and sensors fail in eight ways: flags, slip messages, recovery times",
        run: twin::faults_step,
    },
    Step {
        name: "twin-node",
        what: "pycyphal talks to the node of that ELF: identity, registers, settings that survive a restart, time",
        run: twin::node_step,
    },
    Step {
        name: "twin-update",
        what: "pycyphal updates that ELF and its model over the bus: refusals, swap, rollback, a supply that fails",
        run: || twin::update::step(false),
    },
    Step {
        name: "hil",
        what: "`slipsense hil` replays the demo into the program for a board, on the emulated STM32H743",
        run: twin::hil_step,
    },
    Step {
        name: "qemu-demo",
        what: "the demo episode on the emulated Cortex-M7, bit for bit, raw frames plain and compressed",
        run: || {
            let demo = qemu::Options::episodes(vec![root().join(DEMO_EPISODE)]);
            equal(&demo)?;
            equal(&qemu::Options { compress_raw: true, ..demo })
        },
    },
    Step {
        name: "qemu-real",
        what: "episodes of real recordings on the emulated Cortex-M7, where present",
        run: real,
    },
    Step {
        name: "qemu-real-time",
        what: "the tasks against the clock on the emulated Cortex-M7, on a bus that is free, full, disturbed, gone",
        run: || equal(&qemu::Options::in_real_time(root().join(DEMO_EPISODE), REAL_TIME_S)),
    },
    Step {
        name: "qemu-extreme",
        what: "extreme input on the emulated Cortex-M7, 1 to 3 sensors",
        run: || equal(&qemu::Options::extreme(EXTREME_FRAMES, None)),
    },
    Step {
        name: "qemu-random",
        what: "extreme input on networks of random shape and weights",
        run: random_models,
    },
    Step {
        name: "qemu-kernels",
        what: "the Cortex-M7's kernels against the portable ones, random and extreme input",
        run: qemu::kernels,
    },
    Step {
        name: "qemu-cmsis",
        what: "the FFT of CMSIS-DSP on the emulated Cortex-M7 and its port, bit for bit; the whole pipeline with it",
        run: cmsis::step,
    },
    Step {
        name: "node",
        what: "pycyphal talks to the Cyphal node: every service, registers, storage, an update; on the host",
        run: node::host,
    },
    Step { name: "qemu-node", what: "the same on the emulated Cortex-M7", run: node::emulated },
    Step {
        name: "tables",
        what: "the committed tables are what their script makes",
        run: || script("make_tables.py", &["--check"]),
    },
    Step {
        name: "vectors",
        what: "the committed log-mel vectors are what librosa and scipy give",
        run: || script("make_logmel_vectors.py", &["--check"]),
    },
    Step {
        name: "baselines",
        what: "the committed MFCC, discriminants and regression are what librosa and scikit-learn give",
        run: || script("check_baselines.py", &[]),
    },
    Step {
        name: "can-bits",
        what: "the CAN model's frames, bit by bit, are what an encoder in Python gives",
        run: can_bits,
    },
    Step {
        name: "metrics",
        what: "the benchmark's metrics are what scikit-learn and scipy give",
        run: metrics,
    },
    Step {
        name: "demo",
        what: "the demo runs, and pycyphal decodes its CAN log, raw frames plain and compressed",
        run: demo,
    },
    Step {
        name: "python",
        what: "the Python package: its wheel in an empty environment, bit for bit as the command",
        run: package,
    },
    Step { name: "view", what: "the page of `slipsense view` in a headless Chromium", run: view },
    Step {
        name: "recordings",
        what: "mcap, python-can, cantools and pycyphal read what is recorded and converted",
        run: recordings,
    },
    Step {
        name: "ros2",
        what: "the demo as a bag of ROS 2: rosbags reads every message, definitions hash as ROS' own",
        run: ros2::step,
    },
    Step {
        name: "linux",
        what: "record, replay and monitor on SocketCAN of Debian's kernel, in QEMU: no frame lost, also to a kill",
        run: linux::step,
    },
    Step { name: "deny", what: "licences, sources and bans of all dependencies", run: deny },
];

fn clippy() -> Result<()> {
    let clippy = |packages: &[&str]| run(cargo().arg("clippy").args(packages).args(["--", "-D", "warnings"]));
    clippy(&["--workspace", "--all-targets"])?;
    clippy(&[
        "--package",
        "slipsense",
        "--package",
        "slipsense-qemu",
        "--features",
        cmsis::FEATURE,
        "--all-targets",
    ])?;
    clippy(&["--package", "slipsense-cli", "--features", "train,hil", "--all-targets"])
}

fn host() -> Result<()> {
    let mut whole = cargo();
    // One failure does not hide the next.
    whole.args(["test", "--workspace", "--release", "--quiet", "--no-fail-fast"]);
    run(whole.args(["--features", "slipsense-cli/train"]))?;
    // What the command says where it is built without a tensor library.
    let mut small = cargo();
    small.args(["test", "--release", "--quiet", "--package", "slipsense-cli"]);
    run(small.args(["--test", "errors", "--test", "model"]))?;
    let mut figures = cargo();
    figures.args(["test", "--release", "--quiet", "--package", "slipsense"]);
    run(figures.args(["--test", "host", "--", "features::", "network::", "--nocapture"]))
}

fn docs() -> Result<()> {
    let mut doc = cargo();
    doc.args(["doc", "--no-deps", "--package", "slipsense", "--lib"]).env("RUSTDOCFLAGS", "-D warnings");
    run(&mut doc)
}

fn arm(what: &[&str]) -> Result<()> {
    run(Toolchain::get()?.build().args(what))
}

/// As the next step needs it, so that most is built once.
fn firmware() -> Result<()> {
    for other in ["adxl382", "icm42688"] {
        arm(&[
            "--package",
            "slipsense",
            "--bin",
            "slipsense-firmware",
            "--features",
            &format!("h743,{other}"),
        ])?;
    }
    Board::build_bootloader()?;
    Board::ALL.into_iter().try_for_each(|board| board.build_hil().map(|_| ()))?;
    Board::ALL.into_iter().try_for_each(|board| board.build().map(|_| ()))
}

fn equal(options: &qemu::Options) -> Result<()> {
    match qemu::run(options)? {
        true => Ok(()),
        false => bail!("the emulated Cortex-M7 and this computer disagree"),
    }
}

fn real() -> Result<()> {
    let Ok(dir) = root().join(REAL_EPISODES).read_dir() else {
        eprintln!("no episodes of real recordings in {REAL_EPISODES}: nothing compared");
        return Ok(());
    };
    let mut episodes: Vec<PathBuf> =
        dir.collect::<Result<Vec<_>, _>>()?.iter().map(|entry| entry.path()).collect();
    episodes.retain(|path| path.extension().is_some_and(|extension| extension == "npz"));
    episodes.sort();
    equal(&qemu::Options::episodes(episodes))
}

fn random_models() -> Result<()> {
    for seed in RANDOM_MODELS {
        equal(&qemu::Options::extreme(RANDOM_MODEL_FRAMES, Some(seed)))?;
    }
    Ok(())
}

fn script(name: &str, arguments: &[&str]) -> Result<()> {
    run(python()?.arg(format!("tests/python/{name}")).args(arguments))
}

fn can_bits() -> Result<()> {
    let frames = target_dir().join("can_frames.txt");
    let mut example = cargo();
    example.args(["run", "--release", "--quiet", "--package", "slipsense-can-sim"]);
    run(example.args(["--example", "random_frames", "--", CAN_FRAMES]).arg(&frames))?;
    run(python()?.arg("tests/python/check_can_bits.py").arg(frames))
}

fn metrics() -> Result<()> {
    let cases = target_dir().join("metric_cases.json");
    let mut example = cargo();
    example.args(["run", "--release", "--quiet", "--package", "slipsense-eval"]);
    run(example.args(["--example", "metric_cases", "--"]).arg(&cases))?;
    run(python()?.arg("tests/python/check_metrics.py").arg(cases))
}

/// The demo, and where it wrote to.
pub fn demo_files() -> Result<PathBuf> {
    let out = target_dir().join("demo");
    run(slipsense(&["demo"]).arg("--out").arg(&out))?;
    Ok(out)
}

/// The command, built.
fn slipsense(arguments: &[&str]) -> Command {
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--"]).args(arguments);
    slipsense
}

fn demo() -> Result<()> {
    let check = |out: &Path| {
        let mut check = python()?;
        check.arg("tests/python/check_can_log.py").arg(out.join("can.log")).arg(out.join("predictions.npz"));
        run(check.arg(DEMO_EPISODE))
    };
    check(&demo_files()?)?;
    let out = target_dir().join("demo-compressed");
    run(slipsense(&["run", DEMO_EPISODE, "--raw", "compressed"]).arg("--out").arg(&out))?;
    check(&out)
}

fn package() -> Result<()> {
    let out = demo_files()?;
    let (wheels, venv) = (target_dir().join("wheels"), target_dir().join("wheel-venv"));
    if wheels.exists() {
        std::fs::remove_dir_all(&wheels)?;
    }
    let mut build = python()?;
    build.args(["-m", "maturin", "build", "--release", "--quiet", "--out"]).arg(&wheels);
    run(build.args(["--manifest-path", "host-tools/python/Cargo.toml"]))?;
    run(python()?.args(["-m", "venv", "--clear"]).arg(&venv))?;
    let empty = || command(venv.join("bin/python"));
    let mut install = empty();
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--find-links"]);
    run(install.arg(&wheels).args(["slipsense[can]"]))?;
    let mut check = empty();
    check.arg("tests/python/check_package.py").arg(DEMO_EPISODE);
    run(check.arg(out.join("predictions.npz")).arg(out.join("can.log")))
}

fn view() -> Result<()> {
    if find(BROWSER).is_none() {
        apt_install(&[BROWSER], "looking at the page of `slipsense view`")?;
    }
    let out = demo_files()?;
    let mut check = python()?;
    check.arg("tests/python/check_view.py").arg(target_dir().join("release/slipsense"));
    run(check.arg(out.join("predictions.npz")).arg(out.join("can.log")).arg(&out))
}

/// The demo's traffic recorded, converted to every format and read by the programs that people have.
fn recordings() -> Result<()> {
    let out = target_dir().join("recordings");
    if out.exists() {
        std::fs::remove_dir_all(&out)?;
    }
    let slipsense = |arguments: &[&std::path::Path]| {
        let mut slipsense = cargo();
        slipsense.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--"]);
        run(slipsense.args(arguments))
    };
    let path = std::path::Path::new;
    slipsense(&[path("demo"), path("--out"), &out])?;
    let [log, mcap, blf, dbc] =
        ["recorded.log", "recorded.mcap", "recorded.blf", "slip.dbc"].map(|name| out.join(name));
    slipsense(&[path("record"), &out.join("can.log"), &log, &mcap])?;
    run(python()?.args(["-m", "can.logconvert"]).args([&log, &blf]))?;
    slipsense(&[path("dbc"), path("--out"), &dbc])?;
    let mut check = python()?;
    run(check.arg("tests/python/check_recordings.py").args([&log, &mcap, &blf, &dbc]))?;
    let mut cyphal = python()?;
    cyphal.arg("tests/python/check_can_log.py").arg(&log).arg(out.join("predictions.npz"));
    run(cyphal.arg(DEMO_EPISODE))
}

/// Advisories are left out: they need a database from the network, and change without the code.
fn deny() -> Result<()> {
    let tools = target_dir().join("tools");
    let local = tools.join("bin/cargo-deny");
    let program = if answer(command("cargo-deny").arg("--version")).is_some() {
        PathBuf::from("cargo-deny")
    } else {
        if !local.exists() {
            // Once is not worth optimizing: so it builds in a quarter of the time.
            let mut install = cargo();
            install.env("CARGO_PROFILE_DEV_DEBUG", "0").args([
                "install",
                "cargo-deny",
                "--locked",
                "--debug",
            ]);
            run(install.arg("--root").arg(&tools))?;
        }
        local
    };
    let mut deny: Command = command(program);
    run(deny.args(["--workspace", "check", "bans", "licenses", "sources"]))
}
