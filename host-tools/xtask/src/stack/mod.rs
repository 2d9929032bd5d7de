//! `cargo xtask stack`: how deep the stack of the firmware can get, proven over the linked program, and what
//! the program takes of each memory.
//!
//! Frames come from the compiler, calls from the disassembly, and [`indirect`] says where calls through
//! registers lead. What interrupts preempt each other is said here.

use std::collections::BTreeMap;
use std::fmt::Write;

use anyhow::{Context, Result, ensure};
use clap::Args;

use crate::elf::Image;
use crate::firmware::{BOARD, Program as Firmware};
use crate::regions::Regions;
use crate::table::{Table, thousands};

mod graph;
mod indirect;
mod panicking;
mod program;

use panicking::ends;
use program::Program;

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
const INFERENCE: &str = FRAME_TASKS[3];
const SERVICES: &str = "__serve_task_inner_function::{closure#0}>>::poll";
/// Who preempts whom, lowest first, by function: of each level at most one is on the stack at a time. Inference is
/// called by the executor that the start ends in; its bound is part of the start's.
const LEVELS: [(&str, &[&str]); 5] = [
    ("thread mode", &["Reset", INFERENCE, SERVICES]),
    ("acquisition, priority 6", &["CEC"]),
    ("scan, priority 5", &["DMA1_STREAM0"]),
    (
        "drivers, priority 0",
        &["FDCAN1_IT0", "FDCAN1_IT1", "FLASH", "SysTick", "TIM2", "DMA2_STREAM0", "DMA2_STREAM1"],
    ),
    ("faults", &["HardFault", "DefaultHandler"]),
];
/// What those of them are called whose function says too little.
const NAMES: [(&str, &str); 4] = [
    ("Reset", "start and all that follows"),
    (INFERENCE, "inference task"),
    (SERVICES, "services task"),
    ("DefaultHandler", "unexpected interrupt"),
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
    let image = Image::read(&Firmware::FIRMWARE.build()?)?;
    let regions = Regions::new(&image)?;
    let mut program = Program::new(image)?;
    let functions = program.graph.nodes.len();
    ensure!(
        program.read_off * 2 < functions,
        "the compiler says of few functions what their frames take: is -Zemit-stack-sizes given?"
    );
    indirect::resolve(&mut program)?;
    handlers_are_known(&program)?;
    let (step_functions, step_bytes, may_panic) = frame_path(&program)?;
    let tasks = FRAME_TASKS.iter().map(|task| program.function(task)).collect::<Result<Vec<_>>>()?;
    let task_functions = panicking::reach(&program, &tasks).len();
    let (known, unknown) = panicking::reasons(&program, &tasks);
    let (fits, bounds, ways) = bounds(&program)?;
    print!("{}{bounds}", regions.table());
    println!(
        "\nPipeline::step: {} bytes, {step_functions} functions, no recursion, no call through a register; {} of them \
         hold a check that may panic",
        thousands(step_bytes),
        may_panic.len()
    );
    println!(
        "Tasks of a frame: {task_functions} functions; {} branches that may panic, never taken for a reason that \
         stack/panicking.rs gives; {} without a reason",
        known.len(),
        unknown.len()
    );
    let indirect = program.graph.nodes.iter().filter(|node| node.indirect_calls > 0);
    let indirect: BTreeMap<_, _> = indirect.map(|node| (&node.name, node.indirect_calls)).collect();
    println!(
        "{functions} functions, {} of them assembly whose frame was read off the instructions; {} call through registers \
         at {} places, all resolved by name",
        program.read_off,
        indirect.len(),
        indirect.values().sum::<usize>()
    );
    if options.ways {
        println!("{ways}\nBranches of the tasks of a frame that may panic, and why none is taken");
        known.iter().for_each(|(branch, reason)| println!("  {branch}: {reason}"));
        println!("\nFunctions that call through registers");
        indirect.iter().for_each(|(name, places)| println!("  {places:>7}  {name}"));
    }
    let new: Vec<_> = may_panic.iter().chain(&unknown).collect();
    ensure!(
        new.is_empty(),
        "a frame may end in a panic, and stack/panicking.rs does not say why not: {new:?}"
    );
    Ok(fits && regions.fits())
}

pub fn step() -> Result<()> {
    ensure!(run(&Options { ways: false })?, "the firmware can outgrow its memory");
    Ok(())
}

/// Is the stack's region large enough? The bounds as a table, and the deepest way below each handler.
fn bounds(program: &Program) -> Result<(bool, Table, String)> {
    let title = format!("Stack of the firmware, bytes: bounds over the linked program ({BOARD})");
    let mut table = Table::new(title, &["level", "starts at", "bound"]);
    let saved = (LEVELS.len() as u64 - 1) * EXCEPTION_BYTES;
    let (mut together, mut ways) = (saved, String::new());
    for (level, handlers) in LEVELS {
        let mut deepest = 0;
        for (index, &function) in handlers.iter().enumerate() {
            let name = NAMES.iter().find(|(named, _)| *named == function).map_or(function, |(_, name)| name);
            let root = program.function(function)?;
            let bound = program.graph.bound(root, &|_| false).with_context(|| format!("below {function}"))?;
            table.row([if index == 0 { level } else { "" }, name, &thousands(bound.bytes)]);
            deepest = deepest.max(bound.bytes);
            _ = writeln!(ways, "\n{name}");
            for node in bound.way.into_iter().map(|node| &program.graph.nodes[node]) {
                _ = writeln!(ways, "  {:>7}  {}", thousands(node.frame_bytes), node.name);
            }
        }
        together += deepest;
    }
    let region = program.image.value("_stack_start")? - program.image.value("_stack_end")?;
    table.row([format!("saved at {} preemptions", LEVELS.len() - 1), String::new(), thousands(saved)]);
    table.row(["deepest of each level, together", "", &thousands(together)]);
    table.row(["region of the memory map", "", &thousands(region)]);
    Ok((together <= region, table, ways))
}

/// Every handler in the vector table must have its place in [`LEVELS`].
fn handlers_are_known(program: &Program) -> Result<()> {
    let handlers = LEVELS.iter().flat_map(|(_, handlers)| *handlers);
    let known = handlers.map(|function| program.function(function)).collect::<Result<Vec<_>>>()?;
    for (number, handler) in program.handlers() {
        let name = &program.graph.nodes[handler].name;
        ensure!(
            known.contains(&handler),
            "exception {number} runs {name}, of which stack/mod.rs does not say at which priority"
        );
    }
    Ok(())
}

/// The signal path, without what a panic would print: how many functions, their bytes, and those with a check that may
/// end in a panic, as far as the calls say. It calls nothing through registers; recursion has no bound, so it fails
/// here too.
fn frame_path(program: &Program) -> Result<(usize, u64, Vec<String>)> {
    let root = program.function(FRAME_PATH)?;
    let reach = panicking::reach(program, &[root]);
    for node in reach.iter().map(|&index| &program.graph.nodes[index]).filter(|node| !ends(node)) {
        ensure!(node.indirect_calls == 0, "{} is on the frame path and calls through a register", node.name);
    }
    let bytes = program.graph.bound(root, &ends).context("on the frame path")?.bytes;
    Ok((reach.len(), bytes, panicking::branches(program, &[root])))
}
