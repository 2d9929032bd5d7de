//! The Cyphal node between pycyphal and a stream of bytes: as a process of this computer, and on the emulated
//! Cortex-M7.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::path::Path;
use std::process::Stdio;

use anyhow::{Context, Result};

use crate::process::{Running, command, run, script};
use crate::qemu::machine::Machine;

/// Let pycyphal talk to the node on this computer.
pub fn host(program: &Path) -> Result<()> {
    let child = command(program).stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
    let mut node = Running(child.with_context(|| format!("cannot start {}", program.display()))?);
    let output = node.0.stdout.take().context("the node has a standard output")?;
    let mut port = String::new();
    BufReader::new(output).read_line(&mut port)?;
    check(port.trim().parse().with_context(|| format!("the node printed no port, but `{port}`"))?, "node")
}

/// Let pycyphal talk to the node on the emulated Cortex-M7.
pub fn emulated() -> Result<()> {
    let machine = Machine::build("slipsense-qemu-node")?;
    let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
    // The emulator cannot say which port it took, so it gets one that was free a moment ago.
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let serial = format!("tcp:127.0.0.1:{port},server=on,wait=on,nodelay=on");
    let child = machine.command_with_serial(dir.path(), &serial).spawn();
    let _node = Running(child.context("cannot start the emulator")?);
    check(port, "node on the emulated Cortex-M7")
}

fn check(port: u16, name: &str) -> Result<()> {
    run(script("check_node.py")?.arg(port.to_string()).args(["--name", name]))
}
