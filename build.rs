//! Whether the core has the DSP extension, and link arguments of the firmware and the bootloader. Only of those: a
//! search path printed for the whole package would reach every package that depends on the library and hand it this
//! board's memory map. And the commit that the firmware is built from, which GetInfo tells.

use std::env::var;
use std::fmt::Write;
use std::path::Path;
use std::process::Command;

#[allow(dead_code, reason = "the library uses the rest")]
#[path = "src/update/partitions.rs"]
mod partitions;

use partitions::{FLASH_BASE, NUCLEO_H743ZI2, Partitions};

fn main() {
    for file in ["memory.x", "src/board/h743/board.x", "src/boot/h743/board.x", "src/update/partitions.rs"] {
        println!("cargo:rerun-if-changed={file}");
    }
    // The compiler does not tell a crate of stable Rust: `target_feature = "dsp"` is none of its names.
    println!("cargo:rustc-check-cfg=cfg(arm_dsp)");
    if var("TARGET").is_ok_and(|target| target.starts_with("thumbv7em")) {
        println!("cargo:rustc-cfg=arm_dsp");
    }
    if var("CARGO_FEATURE_H743").is_err() || var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let root = var("CARGO_MANIFEST_DIR").expect("cargo sets it");
    let out = var("OUT_DIR").expect("cargo sets it");
    std::fs::write(Path::new(&out).join("partitions.x"), linker_script(&NUCLEO_H743ZI2))
        .expect("it is writable");
    let programs = [
        ("slipsense-firmware", "board"),
        ("slipsense-hil", "board"),
        ("slipsense-can-loopback", "board"),
        ("slipsense-boot", "boot"),
    ];
    for (program, folder) in programs {
        let folder = format!("-L{root}/src/{folder}/h743");
        for argument in [&folder, &format!("-L{out}"), "--nmagic", "-Tlink.x", "-Tdefmt.x"] {
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

/// `partitions.x`: symbols of the partitions, and that no two of them overlap.
fn linker_script(board: &Partitions) -> String {
    let mut script = format!("/* {}, from src/update/partitions.rs. */\n", board.label);
    let mut spans = board.named();
    spans.sort_by_key(|(_, span)| span.start);
    for (name, span) in &spans {
        let (start, end) = (FLASH_BASE + span.start, FLASH_BASE + span.end);
        writeln!(script, "__{name}_start = {start:#010x};\n__{name}_end = {end:#010x};").expect("a string");
    }
    for pair in spans.windows(2) {
        let [(before, _), (behind, _)] = pair else { continue };
        let text = format!("{before} reaches into {behind}");
        writeln!(script, "ASSERT(__{before}_end <= __{behind}_start, \"{text}\");").expect("a string");
    }
    let end = FLASH_BASE + board.flash.end;
    writeln!(script, "ASSERT(__settings_end <= {end:#010x}, \"settings leave the flash\");")
        .expect("a string");
    script += "ASSERT(__dfu_end - __dfu_start == __active_end - __active_start + 128K, \"embassy-boot's swap needs one sector more\");\n";
    script
}

/// What git answers; `None` where there is no git or no repository, as in a downloaded archive.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let answer = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| answer.trim().to_owned())
}
