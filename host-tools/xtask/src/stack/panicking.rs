//! Which branches of what a frame wakes end in a panic, and why none of them is taken.
//!
//! A branch is a function and the one that it calls to panic, both by name. A new one fails the step: it is removed
//! from the code, or gets its line here with the reason.

use std::collections::BTreeSet;

use super::graph::Node;
use super::program::{PANIC, Program};

/// Beginning of a function's name, part of the name of what it calls to panic, why it never does.
///
/// What only a wrong constant of ours or a register that lies would bring about counts as never: such a chip is not
/// to be trusted with the rest either, and the panic restarts it.
const NEVER_TAKEN: &[(&str, &str, &str)] = &[
    (
        "",
        "panic_const_async_fn_resumed",
        "an executor does not poll a task that has ended, an await no future that is ready",
    ),
    (
        "",
        "core::cell::panic_already",
        "every borrow is within one critical section, and none is within another",
    ),
    (
        "_embassy_time_schedule_wake",
        "core::",
        "as above: the time driver's queue is borrowed in a critical section",
    ),
    (
        "embassy_stm32::dma::",
        "panicking::panic_bounds_check",
        "channels and streams are constants of the peripherals",
    ),
    (
        "embassy_stm32::dma::",
        "panicking::panic",
        "streams as above; a transfer has 1 to 65535 items: SPI_BUFFER_BYTES",
    ),
    (
        "embassy_stm32::can::",
        "core::",
        "buffers are the three that TXFQS counts; a frame has at most 64 bytes",
    ),
    ("embassy_stm32::spi::", "core::", "the driver was made with both DMA channels; lengths as for the DMA"),
    (
        "embassy_embedded_hal::shared_bus::asynch::spi::SpiDevice",
        "core::",
        "the operations are one, a constant; the rest as for embassy_stm32::spi",
    ),
    (
        "embassy_executor::raw::TaskStorage<",
        "core::option::expect_failed",
        "embassy's time of a frame: with bit rate switching it subtracts 0",
    ),
    (
        "embassy_executor::raw::TaskStorage<slipsense_firmware::__receive_task",
        "slice_index_fail",
        "a frame that embassy has read has at most 64 bytes",
    ),
    (
        "embassy_executor::raw::TaskStorage<slipsense_firmware::__transmit_task",
        "core::panicking::panic",
        "embassy's assertion that a task's header is its own",
    ),
    ("slipsense_firmware::can::CanBus as", "core::panicking::panic", "TFQPI has five bits"),
    ("__defmt_default_panic", "core::", "where assertions of embassy's end; who makes them is not listed"),
    ("_defmt_", "core::", "the log is entered with interrupts off, and never from within"),
];

/// The branches below `roots`: those that are never taken, each with the reason, and those without one.
pub fn reasons(program: &Program, roots: &[usize]) -> (Vec<(String, &'static str)>, Vec<String>) {
    let (mut known, mut unknown) = (Vec::new(), Vec::new());
    for branch in branches(program, roots) {
        let reason = NEVER_TAKEN.iter().find(|(function, callee, _)| {
            branch.split_once(ARROW).is_some_and(|(from, to)| {
                from.trim_start_matches('<').starts_with(function) && to.contains(callee)
            })
        });
        match reason {
            Some((_, _, reason)) => known.push((branch, *reason)),
            None => unknown.push(branch),
        }
    }
    (known, unknown)
}

/// Between a function and what it calls.
const ARROW: &str = " -> ";

pub fn ends(node: &Node) -> bool {
    node.name.contains(PANIC)
}

pub fn reach(program: &Program, roots: &[usize]) -> BTreeSet<usize> {
    roots.iter().flat_map(|&root| program.graph.reach(root, &ends)).collect()
}

/// All branches below `roots`: who calls, outside of core, what of core ends in a panic.
pub fn branches(program: &Program, roots: &[usize]) -> Vec<String> {
    let nodes = &program.graph.nodes;
    // What drops a value is named core's and made of ours.
    let of_core =
        |node: &Node| node.name.starts_with("core::") && !node.name.starts_with("core::ptr::drop_in_place");
    let panics = |index: usize| {
        ends(&nodes[index])
            || of_core(&nodes[index])
                && program.graph.reach(index, &ends).iter().any(|&below| ends(&nodes[below]))
    };
    let mut branches = Vec::new();
    for index in reach(program, roots) {
        let node = &nodes[index];
        if ends(node) || of_core(node) {
            continue;
        }
        for &callee in node.calls.iter().filter(|&&callee| panics(callee)) {
            branches.push(format!("{}{ARROW}{}", node.name, nodes[callee].name));
        }
    }
    branches.sort();
    branches
}
