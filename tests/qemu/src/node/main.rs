//! The Cyphal node behind a stream of bytes: on the emulated board its first serial port, on the host a TCP
//! port of this machine. `cargo xtask test --only node` starts both and lets pycyphal talk to them.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod emulated;

#[cfg(not(target_os = "none"))]
mod host;

#[cfg(not(target_os = "none"))]
fn main() -> std::io::Result<()> {
    host::run()
}
