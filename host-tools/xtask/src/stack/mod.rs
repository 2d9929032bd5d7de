//! `cargo xtask stack`: how deep the stack of each board's firmware can get, proven over the linked program, and what
//! the program takes of each memory.
//!
//! Frames come from the compiler, calls from the disassembly, and [`indirect`] says where calls through
//! registers lead. What interrupts preempt each other is said here.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::board::Board;
use crate::elf::Image;
use crate::regions::Regions;

mod graph;
mod indirect;
mod panicking;
mod program;
mod report;

use program::Program;
pub use report::Report;
use report::{FramePath, Level};

/// What an exception puts on the stack: 26 words with the registers of the FPU, and one for the alignment.
const EXCEPTION_BYTES: u64 = 27 * 4;
/// One frame of the signal path, and everything below.
const FRAME_PATH: &str = "pipeline::State>>::step";
/// The tasks that each frame wakes, as their executors poll them.
const FRAME_TASKS: [&str; 4] = [
    "__acquire_task_inner_function::{closure#0}>>::poll",
    "__transmit_task_inner_function::{closure#0}>>::poll",
    "__receive_task_inner_function::{closure#0}>>::poll",
    "__infer_task_inner_function::{closure#0}>>::poll",
];
/// Where a panic ends; what it prints is no part of the frame path.
const PANIC: &str = "rust_begin_unwind";

/// Who preempts whom, lowest first, each by name and function: of each level at most one is on the stack at a
/// time. Inference is called by the executor that the start ends in; its bound is part of the start's.
const LEVELS: [(&str, &[(&str, &str)]); 5] = [
    (
        "thread mode",
        &[
            ("start and all that follows", "Reset"),
            ("inference task", "__infer_task_inner_function::{closure#0}>>::poll"),
            ("services task", "__serve_task_inner_function::{closure#0}>>::poll"),
        ],
    ),
    ("acquisition, priority 6", &[("CEC", "CEC")]),
    ("scan, priority 5", &[("DMA1_STREAM0", "DMA1_STREAM0")]),
    (
        "drivers, priority 0",
        &[
            ("FDCAN1_IT0", "FDCAN1_IT0"),
            ("FDCAN1_IT1", "FDCAN1_IT1"),
            ("FLASH", "FLASH"),
            ("TIM2", "TIM2"),
            ("DMA2_STREAM0", "DMA2_STREAM0"),
            ("DMA2_STREAM1", "DMA2_STREAM1"),
        ],
    ),
    ("faults", &[("HardFault", "HardFault"), ("unexpected interrupt", "DefaultHandler")]),
];

/// What to look at.
#[derive(Args, Clone, Debug)]
#[command(after_help = "\
The bound is the sum over the priorities, because each can preempt those below once, plus what the core saves \
at each preemption. Frames are the compiler's, calls are read from the disassembly, calls through registers \
follow named rules that are checked for gaps. Recursion is an error, and so is a bound above the stack's region.

Examples:
  cargo xtask stack             build the firmware, print the bounds
  cargo xtask stack --ways      and the functions on the deepest way of each handler
  cargo xtask stack --board h743 --json")]
pub struct Options {
    /// Print the functions on the deepest way, with their frames
    #[arg(long)]
    ways: bool,
    /// Print one JSON object on standard output instead of a table
    #[arg(long)]
    json: bool,
    /// One board only [default: all]
    #[arg(long)]
    board: Option<Board>,
    /// A firmware of that board that is built already, with stack sizes [default: build it]
    #[arg(long, value_name = "FILE", requires = "board")]
    elf: Option<PathBuf>,
}

/// `false` if the bound is above what the memory map gives.
pub fn run(options: &Options) -> Result<bool> {
    let mut reports = Vec::new();
    for board in Board::ALL.into_iter().filter(|&board| options.board.is_none_or(|wanted| wanted == board)) {
        reports.push(measure(board, options.elf.clone())?);
    }
    if options.json {
        println!("{}", serde_json::to_string_pretty(&reports)?);
    } else {
        reports.iter().for_each(|report| print!("{}", report.text(options.ways)));
    }
    reports.iter().try_for_each(Report::holds_no_new_panic)?;
    Ok(reports.iter().all(Report::fits))
}

/// The step of the test command.
pub fn step() -> Result<()> {
    for board in Board::ALL {
        let report = measure(board, None)?;
        eprint!("{}", report.text(false));
        ensure!(report.fits(), "{}: the firmware can outgrow its memory", board.label());
        report.holds_no_new_panic()?;
    }
    Ok(())
}

/// Look at a firmware; `None`: build it.
pub fn measure(board: Board, elf: Option<PathBuf>) -> Result<Report> {
    let elf = elf.map_or_else(|| board.build(), Ok)?;
    let image = Image::read(&elf)?;
    let regions = Regions::of(board, &image)?;
    let mut program = Program::of(image)?;
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
        regions,
        region_bytes: start - end,
        exception_bytes: EXCEPTION_BYTES,
        levels: levels.collect::<Result<_>>()?,
        frame_path: frame_path(&program)?,
        frame_tasks: frame_tasks(&program)?,
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
    Ok(FramePath { functions: reach.len(), bytes, may_panic: panicking::of(program, &[root])? })
}

/// All that a frame wakes: who acquires, transmits, receives, decides.
fn frame_tasks(program: &Program) -> Result<panicking::Tasks> {
    let roots = FRAME_TASKS.iter().map(|task| program.function(task)).collect::<Result<Vec<_>>>()?;
    panicking::Tasks::of(program, &roots)
}
