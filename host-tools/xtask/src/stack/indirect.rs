//! Where the firmware's calls through registers lead: rules by name, because a linked program does not say.
//!
//! The rules are held against the program: a function that calls through a register and is in no rule is an
//! error, and so is a function whose address is taken and that no rule leads to.

use std::collections::BTreeSet;

use anyhow::{Result, bail};

use super::PANIC;
use super::program::Program;

/// Functions whose name holds one of `callers` may call, through a register, those whose name holds one of
/// `targets`.
struct Rule {
    callers: &'static [&'static str],
    targets: &'static [&'static str],
}

/// The wakers of embassy's executors.
const WAKERS: &str = "embassy_executor::raw::waker::";
/// The CAN driver's queues behind a trait object, and what drops them.
const CHANNELS: [&str; 2] =
    ["as embassy_sync::channel::DynamicChannel", "drop_in_place::<embassy_sync::channel::Channel"];

/// A text that formats itself into another is the one recursion: see [`resolve`].
const TEXT_IN_TEXT: &str = "<&dyn core::fmt::Display as core::fmt::Display>::fmt";
/// What such a text is: an error in the log, or what a panic says.
const TEXTS: [&str; 2] = ["ModelError as core::fmt::Display>::fmt", "PanicInfo as core::fmt::Display>::fmt"];
const FORMATTER: &str = "core::fmt::write";

const RULES: &[Rule] = &[
    // The executors poll their one task each.
    Rule { callers: &["platform::thread::Executor>::run"], targets: &["__infer_task_inner_function"] },
    Rule { callers: &["CEC"], targets: &["__acquire_task_inner_function"] },
    // Whoever waits or ends a wait: tasks, drivers, queues, the timer.
    Rule {
        callers: &[
            "TaskStorage<",
            "__cortex_m_rt_main",
            "CanTransmit>::transmit",
            "FDCAN1_IT0",
            "can::_version::RxMode>::on_interrupt",
            "TIM2",
            "_embassy_time_schedule_wake",
            CHANNELS[0],
            CHANNELS[1],
        ],
        targets: &[WAKERS],
    },
    Rule {
        callers: &[
            "TaskStorage<",
            "__cortex_m_rt_main",
            "CanTransmit>::transmit",
            "FDCAN1_IT0",
            "RxMode>::on_interrupt",
        ],
        targets: &CHANNELS,
    },
    // The CAN driver raises its own interrupt.
    Rule {
        callers: &[
            "can::_version::Info>::adjust_reference_counter",
            "CanTransmit>::transmit",
            "TaskStorage<",
            "__cortex_m_rt_main",
        ],
        targets: &["typelevel::Interrupt>::pend"],
    },
    // The log's buffer waits for the probe or does not.
    Rule { callers: &["_defmt_"], targets: &["<defmt_rtt::channel::Channel>::"] },
    // Text goes into the log.
    Rule {
        callers: &["core::fmt::Formatter>::", FORMATTER, TEXTS[0], TEXTS[1]],
        targets: &[
            "<defmt::export::FmtWrite as core::fmt::Write>::write_str",
            "<defmt::export::FmtWrite as core::fmt::Write>::write_char",
        ],
    },
    Rule { callers: &TEXTS, targets: &["<defmt::export::FmtWrite as core::fmt::Write>::write_fmt"] },
    // Numbers and words of a text.
    Rule {
        callers: &[FORMATTER],
        targets: &[
            "<&str as core::fmt::Display>",
            "<&&str as core::fmt::Display>",
            "<u16 as core::fmt::Display>",
            "<u32 as core::fmt::Display>",
            "<i32 as core::fmt::Display>",
            "<&i32 as core::fmt::Display>",
            "<i64 as core::fmt::Display>",
            "BorrowMutError as core::fmt::Display>",
        ],
    },
    Rule { callers: &[TEXT_IN_TEXT], targets: &TEXTS },
];

/// Lead every call through a register to the functions that the rules name.
///
/// A text in a text formats through [`FORMATTER`], which formats it through [`FORMATTER`]: two levels, because no
/// error holds another. So the inner level is measured first, counts as one function from then on, and only then
/// does the outer level lead to it. The log may panic, and a panic logs: panic-probe sees to it that the second
/// panic does not.
pub fn resolve(program: &mut Program) -> Result<()> {
    follow_thunks(program);
    check(program)?;
    for rule in RULES {
        let targets = named(program, rule.targets);
        for caller in named(program, rule.callers) {
            if program.graph.nodes[caller].indirect_calls > 0 {
                program.graph.nodes[caller].calls.extend(&targets);
            }
        }
    }
    for text in named(program, &[TEXT_IN_TEXT]) {
        program.graph.seal(text)?;
        for formatter in named(program, &[FORMATTER]) {
            program.graph.nodes[formatter].calls.insert(text);
        }
    }
    for panic in named(program, &[PANIC]) {
        program.graph.seal(panic)?;
    }
    Ok(())
}

/// What the linker puts in where a call is too far for one instruction, such as from flash to ITCM: a jump through a
/// register to the function whose name it carries.
const THUNK: &str = "LongThunk_";

/// Make them the direct calls that they are.
fn follow_thunks(program: &mut Program) {
    let functions = &program.image.functions;
    let leads = |name: &str| {
        let (_, target) = name.split_once(THUNK)?;
        functions.iter().position(|function| function.name == target)
    };
    let thunks: Vec<_> = functions.iter().map(|function| leads(&function.name)).collect();
    for (node, target) in program.graph.nodes.iter_mut().zip(thunks) {
        if let Some(target) = target {
            node.calls.insert(target);
            node.points_to.remove(&target);
            node.indirect_calls = 0;
        }
    }
}

fn check(program: &Program) -> Result<()> {
    let ruled: BTreeSet<usize> = RULES.iter().flat_map(|rule| named(program, rule.callers)).collect();
    let mut led_to: BTreeSet<usize> = RULES.iter().flat_map(|rule| named(program, rule.targets)).collect();
    led_to.extend(named(program, &[TEXT_IN_TEXT]));
    let nodes = program.graph.nodes.iter().enumerate();
    let mut lost: Vec<_> = nodes
        .filter(|(index, node)| node.indirect_calls > 0 && !ruled.contains(index))
        .map(|(_, node)| format!("{} calls through a register", node.name))
        .collect();
    let pointed_to = program.graph.nodes.iter().flat_map(|node| &node.points_to);
    let addresses: BTreeSet<usize> = pointed_to.chain(&program.in_tables).copied().collect();
    let unled = addresses.difference(&led_to).map(|&index| &program.graph.nodes[index].name);
    lost.extend(unled.map(|name| format!("the address of {name} is taken")));
    if !lost.is_empty() {
        bail!("no rule of stack/indirect.rs says where this leads: {}", lost.join("; "));
    }
    Ok(())
}

fn named(program: &Program, parts: &[&str]) -> Vec<usize> {
    let holds = |name: &str| parts.iter().any(|part| name.contains(part));
    let functions = program.image.functions.iter().enumerate();
    let found = functions
        .filter(|(_, function)| holds(&function.name) || function.aliases.iter().any(|alias| holds(alias)));
    found.map(|(index, _)| index).collect()
}
