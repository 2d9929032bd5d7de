//! The steps, cheapest first where nothing else decides.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Result, bail};

use crate::process::{answer, cargo, command, run, target_dir};
use crate::python::python;
use crate::toolchain::Toolchain;
use crate::{cmsis, qemu, root, stack};

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
const DEMO_EPISODE: &str = "host-tools/cli/demo/episode.npz";
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
        what: "the firmware for the NUCLEO-H743ZI2, warnings denied",
        // As the next step needs it, so that it is built once.
        run: || stack::build().map(|_| ()),
    },
    Step { name: "stack", what: "the firmware's stack cannot outgrow its region", run: stack::step },
    Step {
        name: "qemu-demo",
        what: "the demo episode on the emulated Cortex-M7, bit for bit",
        run: || equal(&qemu::Options::episodes(vec![root().join(DEMO_EPISODE)])),
    },
    Step {
        name: "qemu-real",
        what: "episodes of real recordings on the emulated Cortex-M7, where present",
        run: real,
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
        what: "the FFT of CMSIS-DSP on the emulated Cortex-M7 and its port, bit for bit; the front end with it",
        run: cmsis::step,
    },
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
        name: "metrics",
        what: "the benchmark's metrics are what scikit-learn and scipy give",
        run: metrics,
    },
    Step { name: "demo", what: "the demo runs, and pycyphal decodes its CAN log", run: demo },
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
    clippy(&["--package", "slipsense-cli", "--features", "train", "--all-targets"])
}

fn host() -> Result<()> {
    run(cargo().args(["test", "--workspace", "--release", "--quiet", "--features", "slipsense-cli/train"]))?;
    // What the command says where it is built without a tensor library.
    let mut small = cargo();
    small.args(["test", "--release", "--quiet", "--package", "slipsense-cli"]);
    run(small.args(["--test", "errors", "--test", "model"]))?;
    let mut figures = cargo();
    figures.args(["test", "--release", "--quiet", "--package", "slipsense"]);
    run(figures.args(["--test", "features", "--test", "network", "--", "--nocapture"]))
}

fn docs() -> Result<()> {
    let mut doc = cargo();
    doc.args(["doc", "--no-deps", "--package", "slipsense", "--lib"]).env("RUSTDOCFLAGS", "-D warnings");
    run(&mut doc)
}

fn arm(what: &[&str]) -> Result<()> {
    run(Toolchain::get()?.build().args(what))
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

fn metrics() -> Result<()> {
    let cases = target_dir().join("metric_cases.json");
    let mut example = cargo();
    example.args(["run", "--release", "--quiet", "--package", "slipsense-bench"]);
    run(example.args(["--example", "metric_cases", "--"]).arg(&cases))?;
    run(python()?.arg("tests/python/check_metrics.py").arg(cases))
}

fn demo() -> Result<()> {
    let out = target_dir().join("demo");
    let mut slipsense = cargo();
    slipsense.args(["run", "--release", "--quiet", "--package", "slipsense-cli", "--", "demo", "--out"]);
    run(slipsense.arg(&out))?;
    let mut check = python()?;
    check.arg("tests/python/check_can_log.py").arg(out.join("can.log")).arg(out.join("predictions.npz"));
    run(check.arg(DEMO_EPISODE))
}

/// Advisories are left out: they need a database from the network, and change without the code.
fn deny() -> Result<()> {
    let tools = target_dir().join("tools");
    let local = tools.join("bin/cargo-deny");
    let program = if answer(command("cargo-deny").arg("--version")).is_some() {
        PathBuf::from("cargo-deny")
    } else {
        if !local.exists() {
            run(cargo().args(["install", "cargo-deny", "--locked", "--root"]).arg(&tools))?;
        }
        local
    };
    let mut deny: Command = command(program);
    run(deny.args(["--workspace", "check", "bans", "licenses", "sources"]))
}
