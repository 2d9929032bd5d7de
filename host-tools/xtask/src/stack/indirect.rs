//! Where the firmware's calls through registers lead: rules by name, because a linked program does not say.
//!
//! The rules are held against the program: a function that calls through a register and is in no rule is an
//! error, and so is a function whose address is taken and that no rule leads to.

use std::collections::BTreeSet;

use anyhow::{Result, ensure};

use super::program::{PANIC, Program};

/// Functions whose name holds one of `callers` may call, through a register, those whose name holds one of
/// `targets`.
struct Rule {
    callers: &'static [&'static str],
    targets: &'static [&'static str],
}

const WAKERS: &str = "embassy_executor::raw::waker::";
/// The waker of who polls once, or has nothing else to do.
const NO_WAKER: &str = "embassy_futures::block_on::VTABLE";
const PEND: &str = "typelevel::Interrupt>::pend";
/// The entry point, and what it does on every board.
const START: [&str; 3] = ["__cortex_m_rt_main", "slipsense_firmware::run", "slipsense_firmware::make"];
/// A text behind a reference that does not say of what: the log's, and what a record on the bus quotes.
const TEXT_IN_TEXT: &str = "<&dyn core::fmt::Display as core::fmt::Display>::fmt";
/// Texts that format others, each of an earlier line or of numbers and words: see [`resolve`].
const TEXTS: [&[&str]; 4] = [
    &[
        "ModelError as core::fmt::Display>::fmt",
        "SensorCountError as core::fmt::Display>::fmt",
        "LoadReport as core::fmt::Display>::fmt",
        "StoreError as core::fmt::Display>::fmt",
        "CrashRecord as core::fmt::Display>::fmt",
        "FileFailure as core::fmt::Display>::fmt",
        "table::Rule as core::fmt::Display>::fmt",
        "Refusal as core::fmt::Display>::fmt",
        "ImageVersion as core::fmt::Display>::fmt",
        "calibration::Summary as core::fmt::Display>::fmt",
    ],
    &[
        "SettingError as core::fmt::Display>::fmt",
        "PanicMessage as core::fmt::Display>::fmt",
        "commissioning::Failure as core::fmt::Display>::fmt",
    ],
    &["PanicInfo as core::fmt::Display>::fmt", "SlotModel as core::fmt::Display>::fmt"],
    &["Notice as core::fmt::Display>::fmt"],
];
/// Those among them that [`TEXT_IN_TEXT`] may be.
const QUOTED: &[&str] = &[TEXTS[0][0], TEXTS[0][1], TEXTS[0][2], TEXTS[0][3], TEXTS[0][4], TEXTS[2][0]];
/// A text for programmers: what an assertion found.
const FINDING: &str = "<&dyn core::fmt::Debug as core::fmt::Debug>::fmt";
/// Where texts go, in pieces and whole: the log, a record on the bus, the hash of a panic's reason.
const SINKS: [&str; 6] = [
    "<defmt::export::FmtWrite as core::fmt::Write>::write_str",
    "<defmt::export::FmtWrite as core::fmt::Write>::write_char",
    "<slipsense::node::diagnostic::TruncatingWriter as core::fmt::Write>::write_str",
    "<slipsense::node::diagnostic::TruncatingWriter as core::fmt::Write>::write_char",
    "<slipsense::board::crash_record::Hash as core::fmt::Write>::write_str",
    "<slipsense::board::crash_record::Hash as core::fmt::Write>::write_char",
];
const WHOLE_SINKS: [&str; 3] = [
    "<defmt::export::FmtWrite as core::fmt::Write>::write_fmt",
    "<slipsense::node::diagnostic::TruncatingWriter as core::fmt::Write>::write_fmt",
    "<slipsense::board::crash_record::Hash as core::fmt::Write>::write_fmt",
];
const FORMATTER: &str = "core::fmt::write";

const RULES: &[Rule] = &[
    // The executors poll their tasks.
    Rule {
        callers: &["platform::thread::Executor>::run"],
        targets: &["__infer_task_inner_function", "__serve_task_inner_function"],
    },
    Rule {
        callers: &["CEC"],
        targets: &[
            "__acquire_task_inner_function",
            "__receive_task_inner_function",
            "__transmit_task_inner_function",
        ],
    },
    // Whoever waits or ends a wait: tasks, drivers, queues, the timer.
    Rule {
        callers: &[
            "FDCAN1_IT0",
            "can::_version::RxMode>::on_interrupt",
            "TIM2",
            "DMA1_STREAM0",
            "embassy_stm32::dma::",
            "embassy_embedded_hal::shared_bus::",
            "_embassy_time_schedule_wake",
            "slipsense::tasks::services::",
            "slipsense::tasks::shared::Shared<",
            "slipsense_firmware::services::load",
            "firmware::flash::BoardFlash",
            "embassy_stm32::flash::common::Flash>::write",
            "slipsense_firmware::updates::",
            "slipsense::update::",
            "embassy_embedded_hal::flash::",
            "embassy_sync::blocking_mutex::",
            "embassy_sync::mutex::",
            "embassy_sync::waitqueue::",
            "embassy_sync::zerocopy_channel::",
            "embassy_time_queue_utils::Queue>::next_expiration",
            "FLASH",
        ],
        targets: &[WAKERS, NO_WAKER],
    },
    // The CAN driver raises its own interrupt.
    Rule { callers: &["can::_version::Info>::adjust_reference_counter"], targets: &[PEND] },
    // Who does both.
    Rule {
        callers: &["TaskStorage<", START[0], START[1], START[2], "CanTransmit>::transmit"],
        targets: &[WAKERS, NO_WAKER, PEND],
    },
    // The log's buffer waits for the probe or does not.
    Rule { callers: &["_defmt_"], targets: &["<defmt_rtt::channel::Channel>::"] },
    // Texts go somewhere.
    Rule {
        callers: &[
            "core::fmt::Formatter>::",
            FORMATTER,
            "core::fmt::Display>::fmt",
            "PageState as core::fmt::Debug>::fmt",
            "slipsense::tasks::services::",
        ],
        targets: &SINKS,
    },
    Rule { callers: TEXTS[0], targets: &WHOLE_SINKS },
    Rule { callers: TEXTS[1], targets: &WHOLE_SINKS },
    Rule { callers: TEXTS[2], targets: &WHOLE_SINKS },
    Rule { callers: TEXTS[3], targets: &WHOLE_SINKS },
    // Numbers and words of a text, by themselves and behind references.
    Rule {
        callers: &[FORMATTER],
        targets: &[
            "&str as core::fmt::Display>",
            "u8 as core::fmt::Display>",
            "u16 as core::fmt::Display>",
            "u32 as core::fmt::Display>",
            "u32 as core::fmt::LowerHex>",
            "usize as core::fmt::Display>",
            "i32 as core::fmt::Display>",
            "i64 as core::fmt::Display>",
            "<u64 as core::fmt::Debug>",
            "BorrowError as core::fmt::Display>",
            "BorrowMutError as core::fmt::Display>",
        ],
    },
    Rule { callers: &[FINDING], targets: &["<&sequential_storage::PageState as core::fmt::Debug>"] },
    // What several elements of a setting must be together.
    Rule {
        callers: &["slipsense::settings::check", "slipsense::settings::Settings>::set"],
        targets: &["table::k_within_n", "table::distinct"],
    },
    // What is stored is a string of bytes, or a calibration.
    Rule {
        callers: &["sequential_storage::map::"],
        targets: &[
            "<&[u8] as sequential_storage::map::Value>::",
            "store::Record as sequential_storage::map::Value>::",
        ],
    },
];

/// Lead every call through a register to the functions that the rules name.
///
/// A text in a text formats through [`FORMATTER`], which formats it through [`FORMATTER`]: as deep as [`TEXTS`] has
/// lines. So the innermost are measured first, count as one function each from then on, and only then does the next
/// line lead to them. The log may panic, and a panic logs: the handler sees to it that the second panic does not.
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
    let quoted = named(program, QUOTED);
    for text in named(program, &[TEXT_IN_TEXT]) {
        program.graph.nodes[text].calls.extend(&quoted);
    }
    for texts in TEXTS.into_iter().chain([&[TEXT_IN_TEXT, FINDING][..]]) {
        let texts = named(program, texts);
        texts.iter().try_for_each(|&text| program.graph.seal(text))?;
        for formatter in named(program, &[FORMATTER]) {
            program.graph.nodes[formatter].calls.extend(&texts);
        }
    }
    named(program, &[PANIC]).into_iter().try_for_each(|panic| program.graph.seal(panic))
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
    let mut ruled: BTreeSet<usize> = RULES.iter().flat_map(|rule| named(program, rule.callers)).collect();
    ruled.extend(named(program, &[TEXT_IN_TEXT]));
    let mut led_to: BTreeSet<usize> = RULES.iter().flat_map(|rule| named(program, rule.targets)).collect();
    led_to.extend(TEXTS.into_iter().flat_map(|texts| named(program, texts)));
    led_to.extend(named(program, &[TEXT_IN_TEXT, FINDING]));
    // Two words where reset looks first lead there (`board.x`); nobody calls it.
    led_to.extend(program.function("Reset"));
    let nodes = program.graph.nodes.iter().enumerate();
    let unruled = nodes.filter(|(index, node)| node.indirect_calls > 0 && !ruled.contains(index));
    let mut lost: Vec<_> =
        unruled.map(|(_, node)| format!("{} calls through a register", node.name)).collect();
    let pointed_to = program.graph.nodes.iter().flat_map(|node| &node.points_to);
    let addresses: BTreeSet<usize> = pointed_to.chain(&program.in_tables).copied().collect();
    let unled = addresses.difference(&led_to).map(|&index| &program.graph.nodes[index].name);
    lost.extend(unled.map(|name| format!("the address of {name} is taken")));
    ensure!(lost.is_empty(), "no rule of stack/indirect.rs says where this leads: {}", lost.join("; "));
    Ok(())
}

fn named(program: &Program, parts: &[&str]) -> Vec<usize> {
    let holds = |name: &str| parts.iter().any(|part| name.contains(part));
    let functions = program.image.functions.iter().enumerate();
    let found = functions.filter(|(_, function)| function.names.iter().any(|name| holds(name)));
    found.map(|(index, _)| index).collect()
}
