//! Arm's CMSIS-DSP for the feature `cmsis-dsp`: its C source, compiled by Arm's gcc into a library that cargo takes
//! in place of the one that the build script of the crate `cmsis_dsp` would download.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::process::{answer, cargo, command, need, root, run, target_dir, with_lints};
use crate::qemu::machine::Machine;
use crate::toolchain::TARGET;

/// The feature, of the library and of the emulated programs.
pub const FEATURE: &str = "cmsis-dsp";
/// Runs on both sides.
const PROGRAM: &str = "slipsense-qemu-cmsis";
/// What the crate's build script says in `links`.
const LINKS: &str = "arm_cortex_math";
const LIBRARY: &str = "arm_cmsis_dsp";
const FETCH: &str = "host-tools/xtask/src/cmsis/fetch.py";
const GCC: &str = "arm-none-eabi-gcc";
const AR: &str = "arm-none-eabi-ar";
const PACKAGES: [&str; 2] = ["gcc-arm-none-eabi", "libnewlib-arm-none-eabi"];
const FLAGS: [&str; 11] = [
    "-mcpu=cortex-m7",
    "-mthumb",
    "-mfpu=fpv5-d16",
    "-mfloat-abi=hard",
    "-O3",
    // So that what is not called is not linked.
    "-ffunction-sections",
    "-fdata-sections",
    // The crate takes enumerations to be an `int`.
    "-fno-short-enums",
    // The headers of CMSIS-Core are not in the package; this keeps them out. The q31 FFT uses none of their
    // intrinsics.
    "-D__GNUC_PYTHON__",
    "-IInclude",
    "-IPrivateInclude",
];
/// What `arm_rfft_q31` and its initialisation take.
const FILES: [&str; 8] = [
    "TransformFunctions/arm_rfft_q31",
    "TransformFunctions/arm_rfft_init_q31",
    "TransformFunctions/arm_cfft_q31",
    "TransformFunctions/arm_cfft_radix4_q31",
    "TransformFunctions/arm_bitreversal2",
    "BasicMathFunctions/arm_shift_q31",
    "CommonTables/arm_common_tables",
    "CommonTables/arm_const_structs",
];

pub const HELP: &str = "\
Fetches the C source of CMSIS-DSP from Arm's Python package `cmsisdsp`, checks its SHA-256, compiles the real q31 \
FFT with arm-none-eabi-gcc and prints the arguments that hand it to cargo:

  cargo build-h743 --features cmsis-dsp $(cargo xtask cmsis)

Without these arguments the build script of the crate `cmsis_dsp` downloads a compiled library.";

pub fn print() -> Result<()> {
    println!("{}", arguments()?.join(" "));
    Ok(())
}

/// The FFT's C code on the emulated Cortex-M7 against the port there and here, the features made with it, and the
/// front end's tests with it. What follows the front end is the same with either FFT.
pub fn step() -> Result<()> {
    let mut tests = with_lints(cargo());
    tests.args(["test", "--release", "--quiet", "--package", "slipsense", "--features", FEATURE]);
    run(tests.args(["--test", "host", "--", "features"]))?;
    let mut here = with_lints(cargo());
    here.args(["run", "--release", "--quiet", "--package", "slipsense-qemu", "--features", FEATURE]);
    let expected = answer(here.args(["--bin", PROGRAM])).with_context(|| format!("{PROGRAM} failed here"))?;
    let mut feature = vec!["--features".to_owned(), FEATURE.to_owned()];
    feature.extend(arguments()?);
    let text = Machine::build_with(PROGRAM, &feature)?.print()?;
    ensure!(
        text.trim() == expected && text.contains("hash of the features"),
        "the emulated Cortex-M7 prints\n{text}\nand this computer\n{expected}"
    );
    println!("the emulated Cortex-M7 and this computer print the same:\n{text}");
    Ok(())
}

fn arguments() -> Result<Vec<String>> {
    let folder = library()?;
    let key = format!("target.{TARGET}.{LINKS}");
    Ok(vec![
        format!("--config={key}.rustc-link-lib=['static={LIBRARY}']"),
        format!("--config={key}.rustc-link-search=['{}']", folder.display()),
    ])
}

/// The folder of the library; made where it is missing.
fn library() -> Result<PathBuf> {
    let folder = target_dir().join("cmsis-dsp");
    let file = format!("lib{LIBRARY}.a");
    if !folder.join(&file).exists() {
        need(GCC, &PACKAGES, "compiling CMSIS-DSP for the Cortex-M7")?;
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        // Whole or not at all: the library is moved when it is complete.
        let scratch = tempfile::tempdir_in(&folder).with_context(|| folder.display().to_string())?;
        run(command("python3").arg(root().join(FETCH)).arg(scratch.path()))?;
        compile(scratch.path(), &file)?;
        fs::rename(scratch.path().join(&file), folder.join(&file)).context(file)?;
    }
    fs::canonicalize(&folder).with_context(|| folder.display().to_string())
}

fn compile(source: &Path, library: &str) -> Result<()> {
    let mut objects = Vec::new();
    for (number, file) in FILES.iter().enumerate() {
        let object = format!("{number}.o");
        let mut gcc = command(GCC);
        gcc.current_dir(source).args(FLAGS).args(["-c", "-o", &object]).arg(format!("Source/{file}.c"));
        run(&mut gcc)?;
        objects.push(object);
    }
    run(command(AR).current_dir(source).args(["rcs", library]).args(objects))
}
