//! `cargo xtask stack`: how deep the stack of the firmware can get, proven over the linked program, and what
//! the program takes of each memory.
//!
//! Frames come from the compiler, calls from the disassembly, and [`indirect`] says where calls through
//! registers lead. What interrupts preempt each other is said here.

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::elf::Image;
use crate::firmware::Program as Firmware;
use crate::regions::Regions;

mod graph;
mod indirect;
mod panicking;
mod program;
mod report;

use program::{PANIC, Program};
use report::{FramePath, Level, Report};

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
            ("SysTick", "SysTick"),
            ("TIM2", "TIM2"),
            ("DMA2_STREAM0", "DMA2_STREAM0"),
            ("DMA2_STREAM1", "DMA2_STREAM1"),
        ],
    ),
    ("faults", &[("HardFault", "HardFault"), ("unexpected interrupt", "DefaultHandler")]),
];

#[derive(Args, Clone, Debug)]
#[command(after_help = "\
The bound is the sum over the priorities, because each can preempt those below once, plus what the core saves \
at each preemption. Frames are the compiler's, calls are read from the disassembly, calls through registers \
follow named rules that are checked for gaps. Recursion is an error, and so is a bound above the stack's region.

Examples:
  cargo xtask stack             build the firmware, print the bounds
  cargo xtask stack --ways      and the functions on the deepest way of each handler")]
pub struct Options {
    /// Print the functions on the deepest way, with their frames
    #[arg(long)]
    ways: bool,
}

/// `false` if the bound is above what the memory map gives.
pub fn run(options: &Options) -> Result<bool> {
    let report = measure()?;
    print!("{}", report.text(options.ways));
    report.holds_no_new_panic()?;
    Ok(report.fits())
}

pub fn step() -> Result<()> {
    ensure!(run(&Options { ways: false })?, "the firmware can outgrow its memory");
    Ok(())
}

fn measure() -> Result<Report> {
    let image = Image::read(&Firmware::FIRMWARE.build()?)?;
    let regions = Regions::new(&image)?;
    let mut program = Program::new(image)?;
    ensure!(
        program.read_off * 2 < program.graph.nodes.len(),
        "the compiler says of few functions what their frames take: is -Zemit-stack-sizes given?"
    );
    indirect::resolve(&mut program)?;
    handlers_are_known(&program)?;
    let (start, end) = (program.image.value("_stack_start")?, program.image.value("_stack_end")?);
    let levels = LEVELS.iter().map(|&(name, handlers)| level(&program, name, handlers));
    let nodes = &program.graph.nodes;
    let indirect = nodes.iter().filter(|node| node.indirect_calls > 0);
    Ok(Report {
        regions,
        region_bytes: start - end,
        exception_bytes: EXCEPTION_BYTES,
        levels: levels.collect::<Result<_>>()?,
        frame_path: frame_path(&program)?,
        frame_tasks: frame_tasks(&program)?,
        functions: nodes.len(),
        read_off: program.read_off,
        indirect: indirect.map(|node| (node.name.clone(), node.indirect_calls)).collect(),
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
    Ok(FramePath { functions: reach.len(), bytes, may_panic: panicking::branches(program, &[root]) })
}

/// All that a frame wakes: who acquires, transmits, receives, decides.
fn frame_tasks(program: &Program) -> Result<panicking::Tasks> {
    let roots = FRAME_TASKS.iter().map(|task| program.function(task)).collect::<Result<Vec<_>>>()?;
    Ok(panicking::Tasks::new(program, &roots))
}
