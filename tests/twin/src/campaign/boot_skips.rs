//! The bootloader on a firmware that nobody has signed, and any one of its instructions is skipped: as by a dip of the
//! supply at the right moment. It must not start the firmware.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use rigless::emulator::{self, Driver, Host, Start, Stop};
use rigless::image::Image;
use rigless::mcu::Operate;
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;
use slipsense::update::HEADER_BYTES;
use slipsense::update::partitions::FLASH_BASE;

use super::core::{Handle, lock};
use super::{Campaign, Change, Judge, NO_VERDICT, Planned, session};
use crate::arguments::Arguments;
use crate::machine::{CORE_HZ, Fitted, Twin};
use crate::programs::BOARD;

/// How often a copy is looked at, and for how long: three times what the bootloader needs. What takes longer hangs; the
/// watchdog ends it, and the bootloader starts undisturbed.
const STEP_NS: u64 = 1_000_000;
const WATCHED_NS: u64 = 40_000_000;
/// GPIOB_ODR and the red LED's pin.
const GPIOB_ODR: u64 = 0x5802_0414;
const RED: u64 = 1 << 14;

/// What became of a copy: statuses of a process.
const REFUSED: u8 = 1;
const STARTED: u8 = 2;
const HANGS: u8 = 3;
const MISSED: u8 = 4;
const VERDICTS: [(u8, &str); 5] = [
    (REFUSED, "refused: the red LED"),
    (STARTED, "started"),
    (HANGS, "hangs until the watchdog restarts it"),
    (MISSED, "another instruction was next"),
    (NO_VERDICT, "the emulator gave up"),
];

fn is_refused(session: &mut Session<Twin>, at: VirtualNanos) -> bool {
    session.mcu().peek(at, GPIOB_ODR, Width::W32).is_ok_and(|levels| levels & RED != 0)
}

fn is_started(exchange: &Handle) -> bool {
    let slot = u64::from(FLASH_BASE + BOARD.active.start)..u64::from(FLASH_BASE + BOARD.active.end);
    slot.contains(&lock(exchange).pc)
}

/// Runs until the bootloader has refused.
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
    let (start, end) = (u64::from(FLASH_BASE + BOARD.active.start), u64::from(FLASH_BASE + BOARD.active.end));
    let header_at = end - HEADER_BYTES as u64;
    Ok(vec![
        Image::new(path, payload.to_vec(), Some(start))?,
        Image::new(path, header.to_vec(), Some(header_at))?,
    ])
}

/// So many skips for each image; `false` if one was started, or a copy could not be judged.
pub fn run(arguments: &Arguments, fitted: &Fitted, count: usize) -> Result<bool> {
    let boot = arguments.boot.as_deref().context("no bootloader")?;
    let mut good = true;
    for path in &arguments.slot {
        let mut images = vec![Image::new(boot, std::fs::read(boot)?, None)?];
        images.extend(slot(path)?);
        let start = Start::new(&images);

        let exchange = Handle::default();
        lock(&exchange).trace = Some(BTreeMap::new());
        let finished = emulator::run(session(fitted, &exchange)?, &start, UntilRefused)?;
        ensure!(!is_started(&exchange), "{}: started without a skip", path.display());
        ensure!(
            finished.stop.is_some_and(|stop| stop.at.0 < WATCHED_NS),
            "{}: not refused without a skip",
            path.display()
        );
        let trace = lock(&exchange).trace.take().unwrap_or_default();
        let mut planned = Vec::new();
        for (&pc, &[first, last]) in &trace {
            let times = if first == last { &[first][..] } else { &[first, last] };
            planned.extend(times.iter().map(|count| Planned {
                at_ns: (u128::from(*count) * 1_000_000_000 / u128::from(CORE_HZ.get())) as u64,
                change: Change::Skip { pc },
            }));
        }
        planned.sort_by_key(|planned| planned.at_ns);
        let all = planned.len();
        let planned: Vec<Planned> = planned.into_iter().step_by((all / count.max(1)).max(1)).collect();
        println!(
            "{}: the bootloader runs {} instructions, which makes {all} skips; {} of them:",
            path.display(),
            trace.len(),
            planned.len()
        );

        let exchange = Handle::default();
        let core = exchange.clone();
        let mut misses = false;
        let judge: Judge = Box::new(move |session, stop, planned| {
            let Change::Skip { pc } = planned.change else { return Some(NO_VERDICT) };
            if stop.at.0 == planned.at_ns {
                misses = lock(&core).pc != pc;
            }
            match () {
                () if misses => Some(MISSED),
                () if is_started(&core) => Some(STARTED),
                () if is_refused(session, stop.at) => Some(REFUSED),
                () if stop.at.0 > planned.at_ns + WATCHED_NS => Some(HANGS),
                () => None,
            }
        });
        let campaign = Campaign::new(planned, exchange.clone(), STEP_NS, judge);
        let verdicts = emulator::run(session(fitted, &exchange)?, &start, campaign)?.driver.finish()?;
        for (verdict, text) in VERDICTS {
            let count = verdicts.iter().filter(|(_, found)| *found == verdict).count();
            println!("{text:38} {count:>7}");
        }
        let wrong = verdicts.iter().filter(|(_, verdict)| !matches!(*verdict, REFUSED | HANGS));
        for (planned, verdict) in wrong {
            println!("{verdict}: {:x?} at {} ns", planned.change, planned.at_ns);
            good = false;
        }
    }
    Ok(good)
}
