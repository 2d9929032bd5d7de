//! One bit of a register or of the RAM in use flips at a random instant: what a receiver of the slip messages then believes.
//!
//! Silicon corrects a flipped bit of a RAM, by its error correction; the emulator has none. So a flip here stands
//! for one that it does not see: in a register, on a bus, in logic.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rigless::emulator::{self, Start, Stop};
use rigless::symbols::Symbols;
use rigless::time::VirtualNanos;
use sha2::{Digest, Sha256};
use slipsense::settings::Setting;
use slipsense::wire::{FlagState, NodeId, SLIP_PORT, SlipMessage, SlipReceiver, TransferId};

use super::fault_free::{self, FaultFree};
use super::first_access::FirstAccess;
use super::processor::{Handle, REGISTERS};
use super::results::{NO_VERDICT, Results};
use super::{Campaign, InjectedFault, Judge, Planned, session};
use crate::arguments::Arguments;
use crate::fdcan::wire::{Logged, can_frame};
use crate::fitted::Fitted;
use crate::shared::lock;
use crate::{programs, settings};

/// Of the random choice of bits and instants.
const SEED: u64 = 25;
/// Bits flip between these, virtual ns; the board has its flag after 0.4 s.
const FROM_NS: u64 = 500_000_000;
const UNTIL_NS: u64 = 1_500_000_000;
/// How long a flag may be wrong, and how long a child runs.
const WRONG_NS: u64 = 150_000_000;
const WATCHED_NS: u64 = 200_000_000;

/// Verdicts: exit statuses of a child.
const EQUAL: u8 = 1;
const VALUES: u8 = 2;
const REFUSED: u8 = 3;
const RESTART: u8 = 4;
const WRONG: u8 = 5;
const LONG_WRONG: u8 = 6;
const VERDICTS: [(u8, &str); 7] = [
    (EQUAL, "no slip message differs"),
    (VALUES, "other values, the same flag"),
    (REFUSED, "messages that the receiver refuses, finds invalid or misses"),
    (RESTART, "a restart"),
    (WRONG, "a wrong flag for 150 ms at most"),
    (LONG_WRONG, "a wrong flag for longer"),
    (NO_VERDICT, "no verdict"),
];

/// Of [`used`], `.sram_d2`, which the DMAs read too.
const D2: usize = 3;

/// Slip messages, by their sequence number.
type Messages = BTreeMap<u32, SlipMessage>;

/// Bytes of RAM that the firmware uses, by its linker's symbols: statics of each memory, and the stack.
fn used(symbols: &Symbols) -> Result<Vec<Range<u64>>> {
    let at = |name| symbols.get(name).with_context(|| format!("the firmware has no symbol {name}"));
    let spans = [
        ("_stack_end", "_stack_start"),
        ("__sdata", "__ebss"),
        ("__axisram_start", "__axisram_end"),
        ("__sram_d2_start", "__sram_d2_end"),
        ("__sram2_start", "__sram2_end"),
    ];
    spans.into_iter().map(|(start, end)| Ok(at(start)?..at(end)?)).collect()
}

/// Half of them in registers; a longer plan begins with a shorter one.
fn plan(count: usize, used: &[Range<u64>]) -> Vec<Planned> {
    let mut random = ChaCha8Rng::seed_from_u64(SEED);
    let bytes: u64 = used.iter().map(|span| span.end - span.start).sum();
    let one = |number| {
        let at_ns = random.random_range(FROM_NS..UNTIL_NS);
        let fault = if random.random() {
            let number = random.random_range(0..REGISTERS);
            let bits = if number > 16 { 64 } else { 32 };
            InjectedFault::Register { number, bit: random.random_range(0..bits) }
        } else {
            let nth = random.random_range(0..bytes) as usize;
            let address = used.iter().cloned().flatten().nth(nth).expect("one of them");
            InjectedFault::Memory { address, bit: random.random_range(0..8) }
        };
        Planned { number, at_ns, fault }
    };
    (0..count).map(one).collect()
}

/// The board's slip messages, when each was there, and its bytes.
fn slips(log: &[Logged]) -> impl Iterator<Item = (u64, Vec<u8>)> + '_ {
    log.iter().filter(|logged| logged.is_of_board()).filter_map(|logged| {
        let frame = can_frame(&logged.frame)?;
        match TransferId::from_can(frame.id()).ok()? {
            TransferId::Message(id) if id.port == SLIP_PORT && id.node == NodeId::DEFAULT => {
                Some((logged.end_ns, frame.data().to_vec()))
            }
            _ => None,
        }
    })
}

/// What a receiver believes of these messages after a fault at `fault_ns`, compared with `expected`. From a restart on
/// nothing is compared: the board counts from 0.
fn judge(log: &[Logged], restart_ns: Option<u64>, fault_ns: u64, expected: &Messages) -> u8 {
    let mut receiver = SlipReceiver::new(NodeId::DEFAULT);
    let (mut believed, mut values, mut wrong_ns) = (0, false, None);
    for (at_ns, data) in slips(log) {
        let now_us = at_ns / 1000;
        receiver.receive(&data, now_us);
        let Some(message) = receiver.message().filter(|_| receiver.state(now_us) == FlagState::Valid) else {
            continue;
        };
        if at_ns < fault_ns || restart_ns.is_some_and(|restart_ns| at_ns > restart_ns) {
            continue;
        }
        believed += 1;
        let expected = expected.get(&message.sequence);
        values |= expected != Some(message);
        if expected.map(|expected| expected.slip) != Some(message.slip) {
            wrong_ns = Some(at_ns - fault_ns);
        }
    }
    // One less where the fault falls between two messages.
    let periods = WATCHED_NS * 240 / 1_000_000_000;
    match wrong_ns {
        Some(after_ns) if after_ns > WRONG_NS => LONG_WRONG,
        Some(_) => WRONG,
        None if restart_ns.is_some() => RESTART,
        None if believed < periods - 1 => REFUSED,
        None if values => VALUES,
        None => EQUAL,
    }
}

/// `count` children. `false`: more than 1 % of the wrong flags lasted, or a child has no verdict.
pub fn run(arguments: &Arguments, fitted: &Arc<Fitted>, count: usize) -> Result<bool> {
    let bytes = std::fs::read(&arguments.elf)?;
    let mut images = programs::images(&arguments.elf, bytes.clone(), None)?;
    // Without raw messages the emulator has less to do.
    let sensors = arguments.sensors.unwrap_or(1).into();
    images.push(settings::stored(&[(Setting::Sensors, sensors), (Setting::RawDivider, 0)])?);
    let symbols = Symbols::read(&bytes, |value| value & !1)?;
    let start = Start::new(&images);
    let episode = arguments.episode.as_deref().map(std::fs::read).transpose()?.unwrap_or_default();
    // The first eight bytes.
    let sha256 = |bytes: &[u8]| -> String {
        Sha256::digest(bytes)[..8].iter().map(|byte| format!("{byte:02x}")).collect()
    };
    let emulator = sha256(&std::fs::read(std::env::current_exe()?)?);
    let (firmware, episode) = (sha256(&bytes), sha256(&episode));
    let what = format!(
        "bit flips: seed {SEED}, {sensors} sensors, SHA-256 emulator {emulator}, firmware {firmware}, episode {episode}"
    );
    let mut results = Results::open(arguments.results.as_deref(), &what)?;

    // Once without a fault. What the core does not read needs no run.
    let used = used(&symbols)?;
    let plan = plan(count, &used);
    let mut first_access = FirstAccess::default();
    for &Planned { number, at_ns, fault } in &plan {
        if let InjectedFault::Memory { address, .. } = fault
            && !used[D2].contains(&address)
            && !results.verdicts.contains_key(&number)
        {
            first_access.wait(address, at_ns, number);
        }
    }
    let injection = Handle::default();
    lock(&injection).first_access = Some(first_access);
    let until_ns = UNTIL_NS + 2 * WATCHED_NS;
    let mut first = session(fitted, &injection)?;
    first.run_until(VirtualNanos(fault_free::STEP_NS));
    let mut finished = emulator::run(first, &start, FaultFree::new(used, until_ns))?;
    let unread = lock(&injection).first_access.take().unwrap_or_default().unread;
    unread.iter().try_for_each(|number| results.add(*number, EQUAL))?;
    println!(
        "{} of {} flips in bytes that the core overwrites or does not read: not run",
        unread.len(),
        plan.len()
    );
    let log = std::mem::take(&mut finished.session.board_mut().mcu.fdcan[0].wire.log);
    let decoded = slips(&log).map(|(_, data)| {
        let fields = data.split_last().map(|(_, fields)| fields).unwrap_or(&[]);
        SlipMessage::decode(NodeId::DEFAULT, fields).map(|message| (message.sequence, message))
    });
    let messages: Messages =
        decoded.collect::<Result<_, _>>().map_err(|error| anyhow::anyhow!("a slip message: {error:?}"))?;
    ensure!(messages.values().any(|message| message.slip), "the flag is never up in this episode");

    let judge: Judge = Box::new(move |session, _, stop: Stop, planned| {
        let restart_ns = session.resets().first().map(|reset| reset.at.0);
        (stop.at.0 >= planned.at_ns + WATCHED_NS || restart_ns.is_some())
            .then(|| judge(&session.board().mcu.fdcan[0].wire.log, restart_ns, planned.at_ns, &messages))
    });
    let injection = Handle::default();
    let mut campaign = Campaign::new(&plan, results, injection.clone(), fault_free::STEP_NS, judge);
    campaign.fault_free = Some((finished.driver.finish()?, EQUAL));
    let session = session(fitted, &injection)?;
    let verdicts = emulator::run(session, &start, campaign)?.driver.finish()?;
    let judged = plan.iter().filter_map(|planned| Some((*planned, *verdicts.get(&planned.number)?)));
    Ok(report(&judged.collect::<Vec<_>>()))
}

fn report(verdicts: &[(Planned, u8)]) -> bool {
    let of = |verdict: u8| verdicts.iter().filter(move |(_, found)| *found == verdict);
    println!("{:62} {:>9} {:>9}", "one flipped bit of", "registers", "RAM");
    for (verdict, text) in VERDICTS {
        let in_ram = |planned: &Planned| matches!(planned.fault, InjectedFault::Memory { .. });
        let ram = of(verdict).filter(|(planned, _)| in_ram(planned)).count();
        println!("{text:62} {:>9} {ram:>9}", of(verdict).count() - ram);
    }
    for (planned, verdict) in verdicts {
        if [WRONG, LONG_WRONG, NO_VERDICT].contains(verdict) {
            println!("{verdict}: {planned:x?}");
        }
    }
    let all = |verdict| of(verdict).count();
    let (lasting, noticed) = (all(LONG_WRONG), all(REFUSED) + all(RESTART) + all(WRONG));
    println!("{lasting} of the {} flips that reach the flag make it wrong for longer", lasting + noticed);
    all(NO_VERDICT) == 0 && lasting * 100 <= lasting + noticed
}

#[cfg(test)]
mod tests {
    use slipsense::wire::Transmitter;
    use slipsense_can_sim::{Format, Frame, Id, Outcome};

    use super::*;
    use crate::fdcan::wire::MCU;

    const PERIOD_NS: u64 = 4_166_667;
    /// When the fault comes, the 100th message.
    const FAULT_NS: u64 = 100 * PERIOD_NS;

    /// Of messages as the board sends them, but for what `change` makes of one; `None`: it is not sent.
    fn verdict(restart_ns: Option<u64>, change: impl Fn(u32, &mut SlipMessage) -> Option<()>) -> u8 {
        let mut transmitter = Transmitter::new(NodeId::DEFAULT);
        let (mut log, mut messages) = (Vec::new(), Messages::new());
        for sequence in 0..148 {
            let end_ns = u64::from(sequence) * PERIOD_NS;
            let timestamp_us = end_ns / 1000;
            let mut message = SlipMessage { sequence, timestamp_us, sensors: 1, ..SlipMessage::default() };
            messages.insert(sequence, message);
            if change(sequence, &mut message).is_some() {
                let frame = transmitter.slip(&message);
                let frame = Frame::new(Id::Extended(frame.id()), Format::FD, frame.data()).unwrap();
                log.push(Logged { node: MCU, start_ns: end_ns, end_ns, outcome: Outcome::Sent, frame });
            }
        }
        judge(&log, restart_ns, FAULT_NS, &messages)
    }

    #[test]
    fn each_verdict_is_given() {
        assert_eq!(verdict(None, |_, _| Some(())), EQUAL);
        let logit = |n, message: &mut SlipMessage| message.late_frames = u8::from(n > 120);
        assert_eq!(verdict(None, |n, message| Some(logit(n, message))), VALUES);
        assert_eq!(verdict(None, |n, _| (n / 2 != 60).then_some(())), REFUSED);
        assert_eq!(verdict(None, |n, message| Some(message.invalid = u8::from(n / 2 == 60))), REFUSED);
        assert_eq!(verdict(Some(120 * PERIOD_NS), |n, _| (n < 120).then_some(())), RESTART);
        assert_eq!(verdict(None, |n, message| Some(message.slip = n == 120)), WRONG);
        let restart = Some(120 * PERIOD_NS);
        assert_eq!(verdict(restart, |n, message| Some(message.slip = n == 110)), WRONG);
        assert_eq!(verdict(restart, |n, message| Some(message.slip = n > 120)), RESTART);
        assert_eq!(verdict(None, |n, message| Some(message.slip = n >= 120)), LONG_WRONG);
        // Before the fault nothing is compared.
        assert_eq!(verdict(None, |n, message| Some(message.slip = n == 99)), EQUAL);
    }
}
