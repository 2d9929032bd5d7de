//! `cargo xtask stack`: how deep the firmware's stack can get, proven over the linked program.
//!
//! Frames come from the compiler, calls from the disassembly, and [`indirect`] says where calls through
//! registers lead. What interrupts preempt each other is said here.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::elf::Image;
use crate::process::run as start;
use crate::toolchain::Toolchain;

mod graph;
mod indirect;
mod program;
mod report;

use program::Program;
pub use report::Report;
use report::{FramePath, Level};

const FIRMWARE: &str = "slipsense-firmware";
/// What an exception puts on the stack: 26 words with the registers of the FPU, and one for the alignment.
const EXCEPTION_BYTES: u64 = 27 * 4;
/// One frame of the signal path, and everything below.
const FRAME_PATH: &str = "pipeline::State>>::step";
/// Where a panic ends; what it prints is no part of the frame path.
const PANIC: &str = "rust_begin_unwind";

/// Who preempts whom, lowest first, each by name and function: of each level at most one is on the stack at a
/// time. Inference is called by the executor that the start ends in; its bound is part of the start's.
const LEVELS: [(&str, &[(&str, &str)]); 4] = [
    (
        "thread mode",
        &[
            ("start and all that follows", "Reset"),
            ("inference task", "__infer_task_inner_function::{closure#0}>>::poll"),
        ],
    ),
    ("acquisition, priority 6", &[("CEC", "CEC")]),
    ("drivers, priority 0", &[("FDCAN1_IT0", "FDCAN1_IT0"), ("FDCAN1_IT1", "FDCAN1_IT1"), ("TIM2", "TIM2")]),
    ("faults", &[("HardFault", "HardFault"), ("unexpected interrupt", "DefaultHandler")]),
];

/// What to look at.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
The bound is the sum over the priorities, because each can preempt those below once, plus what the core saves \
at each preemption. Frames are the compiler's, calls are read from the disassembly, calls through registers \
follow named rules that are checked for gaps. Recursion is an error, and so is a bound above the stack's region.

Examples:
  cargo xtask stack             build the firmware, print the bound
  cargo xtask stack --ways      and the functions on the deepest way of each handler
  cargo xtask stack --json")]
pub struct Options {
    /// Print the functions on the deepest way, with their frames
    #[arg(long)]
    ways: bool,
    /// Print one JSON object on standard output instead of a table
    #[arg(long)]
    json: bool,
    /// A firmware that is built already, with stack sizes [default: build it]
    #[arg(long, value_name = "FILE")]
    elf: Option<PathBuf>,
}

/// `false` if the bound is above what the memory map gives.
pub fn run(options: &Options) -> Result<bool> {
    let report = measure(options.elf.clone())?;
    if options.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        print!("{}", report.text(options.ways));
    }
    Ok(report.fits())
}

/// The step of the test command.
pub fn step() -> Result<()> {
    let report = measure(None)?;
    eprint!("{}", report.text(false));
    ensure!(report.fits(), "the stack can outgrow its region");
    Ok(())
}

/// Look at a firmware; `None`: build it.
pub fn measure(elf: Option<PathBuf>) -> Result<Report> {
    let elf = elf.map_or_else(build, Ok)?;
    let mut program = Program::of(Image::read(&elf)?)?;
    ensure!(
        program.read_off * 2 < program.graph.nodes.len(),
        "{}: the compiler says of few functions what their frames take: build with -Z emit-stack-sizes",
        elf.display()
    );
    indirect::resolve(&mut program)?;
    handlers_are_known(&program)?;
    let (start, end) = (program.image.value("_stack_start")?, program.image.value("_stack_end")?);
    let levels = LEVELS.iter().map(|&(name, handlers)| level(&program, name, handlers));
    Ok(Report {
        region_bytes: start - end,
        exception_bytes: EXCEPTION_BYTES,
        levels: levels.collect::<Result<_>>()?,
        frame_path: frame_path(&program)?,
        functions: program.graph.nodes.len(),
        read_off: program.read_off,
        indirect: program
            .graph
            .nodes
            .iter()
            .filter(|node| node.indirect_calls > 0)
            .map(|node| (node.name.clone(), node.indirect_calls))
            .collect(),
    })
}

/// The firmware, with a list of what each function takes of the stack.
pub fn build() -> Result<PathBuf> {
    let toolchain = Toolchain::get()?;
    let mut build = toolchain.build_with_stack_sizes();
    start(build.args(["--package", "slipsense", "--bin", FIRMWARE, "--features", "h743"]))?;
    Ok(toolchain.program(FIRMWARE))
}

fn level(program: &Program, name: &'static str, handlers: &[(&str, &str)]) -> Result<Level> {
    let mut roots = Vec::new();
    for (name, function) in handlers {
        let root = program.function(function)?;
        let bound = program.graph.bound(root, &|_| false).with_context(|| format!("below {function}"))?;
        let frame = |&function: &usize| {
            let node = &program.graph.nodes[function];
            (node.name.clone(), node.frame_bytes)
        };
        roots.push(report::Root {
            name: (*name).to_owned(),
            bytes: bound.bytes,
            way: bound.way.iter().map(frame).collect(),
        });
    }
    Ok(Level { name, roots })
}

/// Every handler in the vector table must have its place in [`LEVELS`].
fn handlers_are_known(program: &Program) -> Result<()> {
    let mut known = Vec::new();
    for (_, function) in LEVELS.iter().flat_map(|(_, handlers)| *handlers) {
        known.push(program.function(function)?);
    }
    for (number, handler) in program.handlers() {
        let name = &program.graph.nodes[handler].name;
        ensure!(
            known.contains(&handler),
            "exception {number} runs {name}, of which stack/mod.rs does not say at which priority"
        );
    }
    Ok(())
}

/// The signal path calls nothing through registers; recursion has no bound, so it fails here too.
fn frame_path(program: &Program) -> Result<FramePath> {
    let root = program.function(FRAME_PATH)?;
    let panics = |node: &graph::Node| node.name.contains(PANIC);
    let reach = program.graph.reach(root, &panics);
    for node in reach.iter().map(|&index| &program.graph.nodes[index]).filter(|node| !panics(node)) {
        ensure!(node.indirect_calls == 0, "{} is on the frame path and calls through a register", node.name);
    }
    let bytes = program.graph.bound(root, &panics).context("on the frame path")?.bytes;
    // A function of ours that calls into core and may end there in a panic: where an index or a division is checked.
    let leads_to_panic = |callee: usize| {
        let of_core = program.graph.nodes[callee].name.starts_with("core::");
        of_core
            && program.graph.reach(callee, &panics).iter().any(|&index| panics(&program.graph.nodes[index]))
    };
    let nodes = reach.iter().map(|&index| &program.graph.nodes[index]);
    let ours = nodes.filter(|node| !panics(node) && !node.name.starts_with("core::"));
    let may_panic = ours.filter(|node| node.calls.iter().any(|&callee| leads_to_panic(callee)));
    Ok(FramePath {
        functions: reach.len(),
        bytes,
        may_panic: may_panic.map(|node| node.name.clone()).collect(),
    })
}
