//! The bootloader must not start a firmware that it has to refuse, also where one of its instructions is skipped, as by a
//! dip of the supply.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use rigless::emulator::{self, Driver, Host, Start, Stop};
use rigless::image::Image;
use rigless::mcu::Operate;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use slipsense::update::HEADER_BYTES;

use super::processor::Handle;
use super::results::{NO_VERDICT, Results};
use super::{Campaign, InjectedFault, Judge, Planned, session};
use crate::arguments::Arguments;
use crate::fitted::Fitted;
use crate::machine::{CORE_HZ, Twin};
use crate::programs::{BOARD, addresses};
use crate::shared::lock;

/// How often a child is judged, and for how long: three times what the bootloader needs. The watchdog ends what takes 8 s.
const STEP_NS: u64 = 1_000_000;
const WATCHED_NS: u64 = 40_000_000;
/// `b .`, as in the handlers of faults; and where the core is when it is locked up (ARM DDI 0403, B1.5.15).
const BRANCH_TO_ITSELF: u64 = 0xE7FE;
const LOCKUP: u64 = 0xEFFF_FFFE;
/// GPIOB_ODR and the red LED's pin.
const GPIOB_ODR: u64 = 0x5802_0414;
const RED: u64 = 1 << 14;

/// Verdicts: exit statuses of a child.
const REFUSED: u8 = 1;
const STARTED: u8 = 2;
const LOOPS: u8 = 3;
const BUSY: u8 = 4;
const MISSED: u8 = 5;
const VERDICTS: [(u8, &str); 6] = [
    (REFUSED, "refused: the red LED"),
    (STARTED, "started"),
    (LOOPS, "in an endless loop"),
    (BUSY, "busy after 40 ms"),
    (MISSED, "another instruction was next"),
    (NO_VERDICT, "no verdict"),
];

fn is_refused(session: &mut Session<Twin>, at: VirtualNanos) -> bool {
    session.mcu().peek(at, GPIOB_ODR, Width::W32).is_ok_and(|levels| levels & RED != 0)
}

fn is_started(injection: &Handle) -> bool {
    addresses(BOARD.active).contains(&lock(injection).pc)
}

/// Only the watchdog ends it: the bootloader has no interrupts.
fn is_endless(injection: &Handle, host: &mut dyn Host) -> bool {
    let pc = lock(injection).pc;
    pc == LOCKUP || host.read(pc, Width::W16).is_ok_and(|instruction| instruction == BRANCH_TO_ITSELF)
}

struct UntilRefused;

impl Driver<Twin> for UntilRefused {
    fn on_stop(&mut self, session: &mut Session<Twin>, stop: Stop, _: &mut dyn Host) -> Option<VirtualNanos> {
        let over = is_refused(session, stop.at) || stop.at.0 > WATCHED_NS;
        (!over).then_some(VirtualNanos(stop.at.0 + STEP_NS))
    }
}

/// An image as the slot holds it: the payload at its start, the header at its end.
fn slot(path: &Path) -> Result<Vec<Image>> {
    let image = std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
    let (header, payload) = image.split_at_checked(HEADER_BYTES).context("an image has a header")?;
    let slot = addresses(BOARD.active);
    let header_at = slot.end - HEADER_BYTES as u64;
    Ok(vec![
        Image::new(path, payload.to_vec(), Some(slot.start))?,
        Image::new(path, header.to_vec(), Some(header_at))?,
    ])
}

/// About `count` skips for each image. `false`: one was started, or a child has no verdict.
pub fn run(arguments: &Arguments, fitted: &Arc<Fitted>, count: usize) -> Result<bool> {
    let boot = arguments.boot.as_deref().context("no bootloader")?;
    let mut good = true;
    for path in &arguments.slot {
        let mut images = vec![Image::new(boot, std::fs::read(boot)?, None)?];
        images.extend(slot(path)?);
        let start = Start::new(&images);

        let injection = Handle::default();
        lock(&injection).trace = Some(BTreeMap::new());
        let finished = emulator::run(session(fitted, &injection)?, &start, UntilRefused)?;
        ensure!(!is_started(&injection), "{}: started without a skip", path.display());
        ensure!(
            finished.stop.is_some_and(|stop| stop.at.0 < WATCHED_NS),
            "{}: not refused without a skip",
            path.display()
        );
        let trace = lock(&injection).trace.take().unwrap_or_default();
        let mut planned = Vec::new();
        for (&pc, &[first, last]) in &trace {
            let times = if first == last { &[first][..] } else { &[first, last] };
            planned.extend(times.iter().map(|count| Planned {
                number: 0,
                at_ns: (u128::from(*count) * 1_000_000_000 / u128::from(CORE_HZ.get())) as u64,
                fault: InjectedFault::Skip { pc },
            }));
        }
        planned.sort_by_key(|planned| planned.at_ns);
        let all = planned.len();
        let every = (all / count.max(1)).max(1);
        let numbered = |(number, planned)| Planned { number, ..planned };
        let planned: Vec<Planned> = planned.into_iter().step_by(every).enumerate().map(numbered).collect();
        println!(
            "{}: the bootloader runs {} instructions, that is {all} skips; {} of them:",
            path.display(),
            trace.len(),
            planned.len()
        );

        let injection = Handle::default();
        let core = injection.clone();
        let mut misses = false;
        let judge: Judge = Box::new(move |session, host, stop, planned| {
            let InjectedFault::Skip { pc } = planned.fault else { return Some(NO_VERDICT) };
            if stop.at.0 == planned.at_ns {
                misses = lock(&core).pc != pc;
            }
            match () {
                () if misses => Some(MISSED),
                () if is_started(&core) => Some(STARTED),
                () if is_refused(session, stop.at) => Some(REFUSED),
                () if stop.at.0 <= planned.at_ns + WATCHED_NS => None,
                () if is_endless(&core, host) => Some(LOOPS),
                () => Some(BUSY),
            }
        });
        let campaign = Campaign::new(&planned, Results::default(), injection.clone(), STEP_NS, judge);
        let verdicts = emulator::run(session(fitted, &injection)?, &start, campaign)?.driver.finish()?;
        for (verdict, text) in VERDICTS {
            let count = verdicts.values().filter(|found| **found == verdict).count();
            println!("{text:38} {count:>7}");
        }
        let wrong = verdicts.iter().filter(|(_, verdict)| !matches!(**verdict, REFUSED | LOOPS | BUSY));
        for (number, verdict) in wrong {
            let planned = planned[*number];
            println!("{verdict}: {:x?} at {} ns", planned.fault, planned.at_ns);
            good = false;
        }
    }
    Ok(good)
}
