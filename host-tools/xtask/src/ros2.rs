//! The ROS 2 node and the bags, read by programs that others wrote.
//!
//! The bag is part of the test command. The node speaks to a network, which a machine that tests may not have: it and
//! ROS' own parser of message files are a command of their own.

use std::path::Path;

use anyhow::Result;

use crate::process::{
    DEMO_EPISODE, answer, apt_install, cargo, command, root, run, script, small_cli, target_dir,
};

const PROGRAM: &str = "slipsense-ros2";
const MESSAGES: &str = "host-tools/ros2/slipsense_msgs/msg";
/// Debian's packages belong to Debian's Python.
const SYSTEM_PYTHON: &str = "/usr/bin/python3";
/// Reads message files as `colcon build` does.
const PARSE: &str = "
import pathlib, sys
from rosidl_adapter.parser import parse_message_file
for path in sorted(pathlib.Path(sys.argv[1]).glob('*.msg')):
    message = parse_message_file('slipsense_msgs', str(path))
    print(f'{message.base_type}: {len(message.fields)} fields, {len(message.constants)} constants')
";

pub fn whole() -> Result<()> {
    run(cargo().args(["build", "--release", "--quiet", "--package", PROGRAM]))?;
    let (program, demo) = (target_dir().join("release").join(PROGRAM), target_dir().join("demo-ros2"));
    run(command(small_cli()?).args(["demo", "--out"]).arg(&demo))?;
    bag(&program, &demo)?;
    if answer(command(SYSTEM_PYTHON).args(["-c", "import rosidl_adapter"])).is_none() {
        apt_install(&["python3-rosidl"], "reading message files as ROS 2 does")?;
    }
    run(command(SYSTEM_PYTHON).args(["-c", PARSE]).arg(root().join(MESSAGES)))?;
    let mut check = script("check_ros2.py")?;
    check.arg("node").arg(&program).arg(demo.join("can.log"));
    run(check.arg(demo.join("predictions.npz")).arg(DEMO_EPISODE))?;
    run(script("check_ros2.py")?.arg("tare").arg(program).arg(demo.join("can.log")))
}

pub fn bag(program: &Path, demo: &Path) -> Result<()> {
    let (bag, log) = (target_dir().join("demo-bag"), demo.join("calibrated.log"));
    if bag.exists() {
        std::fs::remove_dir_all(&bag)?;
    }
    run(script("check_ros2.py")?.arg("log").arg(demo.join("can.log")).arg(&log))?;
    run(command(program).arg("bag").arg(log).arg(&bag))?;
    let mut check = script("check_ros2.py")?;
    run(check.arg("bag").arg(&bag).arg(demo.join("predictions.npz")).arg(DEMO_EPISODE))
}
