//! Whether the core has the DSP extension, and link arguments of the firmware binary. Only of that: a search
//! path printed for the whole package would reach every package that depends on the library and hand it this
//! board's memory map.

use std::env::var;

fn main() {
    println!("cargo:rerun-if-changed=src/board/h743/board.x");
    println!("cargo:rerun-if-changed=memory.x");
    // The compiler does not tell a crate of stable Rust: `target_feature = "dsp"` is none of its names.
    println!("cargo:rustc-check-cfg=cfg(arm_dsp)");
    if var("TARGET").is_ok_and(|target| target.starts_with("thumbv7em")) {
        println!("cargo:rustc-cfg=arm_dsp");
    }
    if var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") || var("CARGO_FEATURE_H743").is_err() {
        return;
    }
    let root = var("CARGO_MANIFEST_DIR").expect("cargo sets it");
    for argument in [&format!("-L{root}/src/board/h743"), "--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bin=slipsense-firmware={argument}");
    }
}
