//! The Cyphal node between pycyphal and a stream of bytes: first as a process of this computer, then on the
//! emulated Cortex-M7.

use std::io::{BufRead, BufReader};
use std::net::TcpListener;
use std::process::{Child, Stdio};

use anyhow::{Context, Result};

use crate::process::{cargo, command, run, target_dir};
use crate::python::python;
use crate::qemu::machine::Machine;

const PROGRAM: &str = "slipsense-qemu-node";
const CHECK: &str = "tests/python/check_node.py";

/// A program that is stopped when it is not needed any more.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself, when its client was gone.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Let pycyphal talk to the node on this computer.
pub fn host() -> Result<()> {
    let mut build = cargo();
    build.args(["build", "--release", "--quiet", "--package", "slipsense-qemu", "--bin", PROGRAM]);
    run(&mut build)?;
    let program = target_dir().join("release").join(PROGRAM);
    let mut start = command(&program);
    let child = start.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
    let mut node = Running(child.with_context(|| format!("cannot start {}", program.display()))?);
    let said = node.0.stdout.take().context("the node has a standard output")?;
    let mut port = String::new();
    BufReader::new(said).read_line(&mut port)?;
    let port: u16 = port.trim().parse().with_context(|| format!("{PROGRAM} said no port, but `{port}`"))?;
    check(port, "node on this computer")
}

/// Let pycyphal talk to the node on the emulated Cortex-M7.
pub fn emulated() -> Result<()> {
    let machine = Machine::build(PROGRAM, &[])?;
    let dir = tempfile::tempdir().context("cannot make a folder for the emulator")?;
    // The emulator cannot say which port it took, so it is told one that was free a moment ago.
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let serial = format!("tcp:127.0.0.1:{port},server=on,wait=on,nodelay=on");
    let child = machine.command_with_serial(dir.path(), &serial).spawn();
    let _node = Running(child.context("cannot start the emulator")?);
    check(port, "node on the emulated Cortex-M7")
}

fn check(port: u16, name: &str) -> Result<()> {
    run(python()?.arg(CHECK).arg(port.to_string()).args(["--name", name]))
}
