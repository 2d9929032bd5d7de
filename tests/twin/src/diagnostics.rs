//! What the emulator reports about the firmware: rules of the manual that it broke, registers that nothing models. Each
//! line that is expected has its reason here; any other fails the run.

use rigless::session::Session;

use crate::arguments::Arguments;
use crate::machine::Twin;

/// One line, and why it is no mistake of the firmware's, if it is not.
#[derive(Clone, Debug)]
pub struct Diagnostic {
    pub line: String,
    pub reason: Option<&'static str>,
}

/// Beginnings of lines and reasons.
const EXPECTED: &[(&str, &str)] = &[
    (
        "RCC CFGR: DS12110 rev 11 table 112",
        "the emulator does not know voltage scale 0; the run checks that SYSCFG_PWRCR.ODEN is set before",
    ),
    ("RCC D1CFGR: DS12110 rev 11 table 112", "as above"),
    ("RCC D2CFGR: DS12110 rev 11 table 112", "as above"),
    (
        "FDCAN1 FDCAN_DBTP: more than 1 Mbit/s without transceiver delay compensation",
        "embassy-stm32 0.6 never sets TDC (#5273); can.rs sets it 20 µs later, before the first frame",
    ),
    (
        "RAMECC",
        "the RAMs have no error correction here: the monitors' registers read what was written last, 0 before",
    ),
];

/// The same where the far end may restart the board.
const EXPECTED_OF_FAR_END: &[(&str, &str)] = &[
    ("reset at ", "asked for by the far end, or by the supply that it lets fail; the watchdog's are counted"),
    (
        "FDCAN1 FDCAN_CCCR: INIT was set while a frame was on the bus",
        "can.rs sets it again to set TDC: a frame of another node is not received, none of ours is there yet",
    ),
];

const EXPECTED_OF_BOOTLOADER: &[(&str, &str)] = &[(
    "refused at 0x40000024: TIM2.CNT is gated",
    "the bootloader's log asks embassy's clock for the time, which only the firmware starts: it reads 0",
)];

/// The same on the desk, where the clock on PH0 may be wrong.
const EXPECTED_ON_DESK: &[(&str, &str)] = &[
    (
        "FDCAN1 FDCAN_CCCR: INIT was cleared while the kernel clock stands still",
        "the bring-up program finds so that there is no clock",
    ),
    ("RCC PLLCFGR: RM0433 rev 9 8.7.13 and DS12110 rev 11 tables 137, 138", "a clock that is 1 % fast"),
];

pub fn collect(session: &Session<Twin>, arguments: &Arguments) -> Vec<Diagnostic> {
    let mut lines: Vec<String> =
        session.told().map(|told| format!("{} {}: {}", told.instance, told.register, told.reason)).collect();
    lines.extend(session.unmapped().iter().map(|unmapped| format!("unmapped access: {unmapped}")));
    let refused = session.refused().iter();
    lines.extend(refused.map(|(address, fault)| format!("refused at {address:#010x}: {fault}")));
    lines.extend(session.unimplemented().values().map(|gap| {
        let (instance, register) = (gap.instance, gap.register);
        format!(
            "{instance} {register}: no model; {} reads, {} writes, first at {:#010x}",
            gap.reads, gap.writes, gap.program_counter
        )
    }));
    lines.extend(session.undefined().iter().map(|(address, undefined)| {
        format!(
            "{}: undefined register at {address:#010x}, first from {:#010x}",
            undefined.instance, undefined.program_counter
        )
    }));
    let unrouted = session.unrouted().iter();
    lines.extend(unrouted.map(|(instance, line)| format!("{instance}: interrupt {line} reaches no line")));
    let resets = session.resets().iter();
    lines.extend(resets.map(|reset| format!("reset at {} ns: {:?}", reset.at.0, reset.cause)));
    let sets = [
        (true, EXPECTED),
        (arguments.far_end, EXPECTED_OF_FAR_END),
        (arguments.boot.is_some(), EXPECTED_OF_BOOTLOADER),
        (arguments.desk.is_some(), EXPECTED_ON_DESK),
    ];
    let expected = || sets.iter().filter(|(is_so, _)| *is_so).flat_map(|(_, lines)| *lines);
    let reason =
        |line: &str| expected().find(|(start, _)| line.starts_with(start)).map(|(_, reason)| *reason);
    lines.into_iter().map(|line| Diagnostic { reason: reason(&line), line }).collect()
}
