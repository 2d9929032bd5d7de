//! Whether the core has the DSP extension, and link arguments of the board's programs. Only of those: a search path
//! printed for the whole package would reach every package that depends on the library and hand it this board's memory
//! map. And the commit that the firmware is built from, for GetInfo.

use std::env::var;
use std::path::Path;
use std::process::Command;

/// The board's programs, and the folder of `src/firmware/bin` that has the memory map of each.
const PROGRAMS: [(&str, &str); 5] = [
    ("slipsense-firmware", "app"),
    ("slipsense-bringup", "app"),
    ("slipsense-hil", "app"),
    ("slipsense-can-loopback", "app"),
    ("slipsense-boot", "boot"),
];

fn main() {
    println!("cargo:rerun-if-changed=memory.x");
    println!("cargo:rerun-if-changed=src/firmware/bin/app/board.x");
    println!("cargo:rerun-if-changed=src/firmware/bin/boot/board.x");
    // The compiler does not tell a crate of stable Rust: `target_feature = "dsp"` is none of its names.
    println!("cargo:rustc-check-cfg=cfg(arm_dsp)");
    if var("TARGET").is_ok_and(|target| target.starts_with("thumbv7em")) {
        println!("cargo:rustc-cfg=arm_dsp");
    }
    if var("CARGO_FEATURE_H743").is_err() {
        return;
    }
    let root = var("CARGO_MANIFEST_DIR").expect("cargo sets it");
    for (program, folder) in PROGRAMS {
        let folder = format!("-L{root}/src/firmware/bin/{folder}");
        for argument in [&folder, "--nmagic", "-Tlink.x", "-Tdefmt.x"] {
            println!("cargo:rustc-link-arg-bin={program}={argument}");
        }
    }
    if let Some(commit) = git(&["rev-parse", "HEAD"]) {
        println!("cargo:rustc-env=SLIPSENSE_COMMIT={commit}");
    }
    // Written by every commit and checkout.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|log| Path::new(log).exists()) {
        println!("cargo:rerun-if-changed={log}");
    }
}

/// What git answers; `None` where there is no git or no repository, as in a downloaded archive.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let answer = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| answer.trim().to_owned())
}
