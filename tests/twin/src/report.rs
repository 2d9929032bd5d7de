//! What a run printed.

use std::collections::HashMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use anyhow::Result;
use slipsense_can_sim::Outcome;
use slipsense_recording::candump::CandumpWriter;

use crate::arguments::Arguments;
use crate::compare::{Comparison, Slip, clock_ahead_ns, compare, tick_ns};
use crate::fault_injection::Faults;
use crate::fault_schedule;
use crate::fdcan::wire::{Logged, MCU, can_frame};
use crate::fitted::Fitted;
use crate::machine::CORE_HZ;
use crate::recovery::{self, Recovery};
use crate::restarts;
use crate::run::Done;

/// Longest time from a tick until its slip message is in the FDCAN's queue, µs: with one sensor, and with more.
const QUEUED_MAX_US: [f64; 2] = [1300.0, 3400.0];
/// Lines of one kind of difference that are shown.
const SHOWN: usize = 5;

/// The bus as a candump log, in virtual time.
pub fn write_candump(path: &Path, frames: &[Logged]) -> Result<()> {
    let mut log = CandumpWriter::new(File::create(path)?, "can0")?;
    for logged in frames.iter().filter(|logged| logged.outcome == Outcome::Sent) {
        if let Some(frame) = can_frame(&logged.frame) {
            log.write(logged.end_ns / 1000, &frame)?;
        }
    }
    log.finish()?;
    Ok(())
}

/// Everything that two equal runs have in common, one thing a line.
pub fn write_trace(path: &Path, done: &Done) -> Result<()> {
    let mut trace = std::io::BufWriter::new(File::create(path)?);
    let Done { frames, interrupts, instructions, virtual_ns, clock_us, .. } = done;
    for logged in frames {
        writeln!(trace, "{logged:?}")?;
    }
    for (name, count) in interrupts {
        writeln!(trace, "{count} interrupts of {name}")?;
    }
    writeln!(trace, "{instructions} instructions in {virtual_ns} ns, clock {clock_us} us")?;
    Ok(trace.flush()?)
}

/// Prints everything. `false`: something differs, or the emulator reported something without a known reason.
pub fn print(done: &Done, fitted: &Fitted, arguments: &Arguments) -> Result<bool> {
    let (episode, faults) = (fitted.episode.as_deref(), &fitted.faults);
    if arguments.rtt {
        done.log.iter().for_each(|line| println!("log  {line}"));
    }
    let comparison = compare(done, episode)?;
    let expected_only = print_reports(done);
    let queued_us = queued_us(done, faults, &comparison.slips);
    print_bus(done, &comparison, queued_us);
    print_comparison(done, &comparison, episode.is_some());
    let recoveries = Recovery::of_run(done, faults, &comparison.slips);
    recovery::print(&recoveries);
    let seconds = done.virtual_ns as f64 / 1e9;
    let interrupts: u64 = done.interrupts.values().sum();
    println!("interrupts: {:.0} per virtual second", interrupts as f64 / seconds);
    for (name, count) in done.interrupts.iter().filter(|(_, count)| **count > 0) {
        println!("  {:>9.0} {name}", *count as f64 / seconds);
    }
    print_time(done);
    let many = comparison.slips.first().is_some_and(|slip| slip.message.sensors > 1);
    let in_time = queued_us <= QUEUED_MAX_US[usize::from(many)];
    if !in_time {
        println!("FAILED: a slip message came later into the queue than {QUEUED_MAX_US:?} us allow");
    }
    if !done.overdrive {
        println!("FAILED: SYSCFG_PWRCR.ODEN is not set: 480 MHz needs voltage scale 0");
    }
    // With faults from the command line frames are lost on purpose; those decided are the host's all the same, to the end
    // where all that is sent arrives at last.
    let is_cut_off = faults.all().iter().any(|fault| fault.kind.takes_the_bus());
    let to_the_end = comparison.ended.is_none() && comparison.compared > 0;
    let mut whole = comparison.different.is_empty() && (is_cut_off || to_the_end);
    if arguments.faults {
        let complaints = fault_schedule::complaints(&recoveries);
        complaints.iter().for_each(|line| println!("FAILED: {line}"));
        whole = complaints.is_empty() && comparison.different.is_empty() && comparison.compared > 0;
    } else if faults.all().is_empty() {
        whole =
            comparison.is_equal(episode.is_some()) && comparison.skipped == 0 && comparison.uneven.is_empty();
    }
    Ok(expected_only && done.overdrive && in_time && scanned_fast(done) && whole)
}

/// The fast path of the scan must recognize the firmware's set-up: without it a run takes several times as long, and
/// nothing else shows it.
fn scanned_fast(done: &Done) -> bool {
    if done.scans_by_events > 0 {
        println!("FAILED: {} scans began event by event (scan_fast_path.rs)", done.scans_by_events);
    }
    done.scans_by_events == 0
}

fn print_time(done: &Done) {
    let seconds = done.virtual_ns as f64 / 1e9;
    println!(
        "{seconds:.3} virtual s in {:.2} s: {:.2} virtual s per s, {} instructions at one per cycle of {} MHz",
        done.wall.as_secs_f64(),
        seconds / done.wall.as_secs_f64(),
        done.instructions,
        CORE_HZ.get() / 1_000_000
    );
}

/// Of another firmware than the board's: its log, and whether it says what it has to.
pub fn print_other(done: &Done, expected: &[String]) -> bool {
    done.log.iter().for_each(|line| println!("log  {line}"));
    let expected_only = print_reports(done);
    let said = |text: &&String| done.log.iter().any(|line| line.contains(*text));
    let unsaid: Vec<_> = expected.iter().filter(|text| !said(text)).collect();
    unsaid.iter().for_each(|text| println!("FAILED: the log does not say: {text}"));
    print_time(done);
    expected_only && unsaid.is_empty()
}

/// The report of a run with a program at the far end, which has judged the run itself. `false`: the emulator reported
/// something without a known reason, or the watchdog restarted the board another number of times than `bites`.
pub fn print_far_end(done: &Done, bites: usize) -> bool {
    let expected_only = print_reports(done);
    restarts::print(done);
    let bitten = restarts::bites(done);
    if bitten != bites {
        println!("FAILED: the watchdog restarted the board {bitten} times, {bites} times were expected");
    }
    if done.read_flags > 0 {
        println!("flash: {} flags of reads raised", done.read_flags);
    }
    let of_others = done.frames.iter().filter(|logged| logged.node != MCU).count();
    println!(
        "bus: {} frames, {of_others} of them from the far end; {:.3} virtual s in {:.2} s",
        done.frames.len(),
        done.virtual_ns as f64 / 1e9,
        done.wall.as_secs_f64()
    );
    expected_only && scanned_fast(done) && bitten == bites
}

/// `false`: the emulator reported something without a known reason.
fn print_reports(done: &Done) -> bool {
    let mut good = true;
    for report in &done.diagnostics {
        match report.reason {
            Some(reason) => println!("report {} [expected: {reason}]", report.line),
            None => {
                println!("UNEXPECTED {}", report.line);
                good = false;
            }
        }
    }
    good
}

fn print_bus(done: &Done, comparison: &Comparison, queued_us: f64) {
    let mine = || done.frames.iter().filter(|logged| logged.node == MCU);
    let sent = mine().filter(|logged| logged.outcome == Outcome::Sent).count();
    let failed = mine().count() - sent;
    let busy: u64 = done.frames.iter().map(|logged| logged.end_ns - logged.start_ns).sum();
    println!(
        "bus: {sent} frames sent, {failed} attempts failed, {} of others, {:.1} % busy",
        done.frames.len() - mine().count(),
        100.0 * busy as f64 / done.virtual_ns as f64
    );
    let Some(first) = comparison.slips.first() else {
        println!("no slip message");
        return;
    };
    println!("boot: first slip message {:.3} ms after reset", first.end_ns as f64 / 1e6);
    let ahead_ns = clock_ahead_ns(done, &comparison.slips);
    let age = |slip: &&Slip| {
        (slip.end_ns as i64 + ahead_ns - slip.message.timestamp_us as i64 * 1000).max(0) as u64
    };
    let worst = comparison.slips.iter().max_by_key(age).unwrap_or(first);
    let sum: u64 = comparison.slips.iter().map(|slip| age(&slip)).sum();
    println!(
        "slip message on the bus after its tick: worst {:.1} us (frame {}), mean {:.1} us",
        age(&worst) as f64 / 1000.0,
        worst.message.sequence,
        sum as f64 / 1000.0 / comparison.slips.len() as f64
    );
    println!("slip message in the FDCAN's queue after its tick: worst {queued_us:.1} us");
    let worst = done.requests.iter().map(|(from, to)| to - from).max().unwrap_or(0);
    let worst_us = worst as f64 / 1000.0;
    println!("a frame in the FDCAN's queue: at most {worst_us:.1} us from its request to its end");
}

/// The longest time from a tick, or from the return of a bus that was lost then, until its slip message was in the
/// FDCAN's queue; 0 without one.
fn queued_us(done: &Done, faults: &Faults, slips: &[Slip]) -> f64 {
    let ahead_ns = clock_ahead_ns(done, slips);
    let requested: HashMap<u64, u64> = done.requests.iter().map(|&(from, to)| (to, from)).collect();
    let waits_ns = slips.iter().filter_map(|slip| {
        let from = *requested.get(&slip.end_ns)?;
        let tick_ns = tick_ns(&slip.message, ahead_ns);
        let taken = faults.all().iter().filter(|fault| fault.kind.takes_the_bus());
        let taken = taken.map(|fault| fault.when.start..fault.when.end + fault.kind.recovery_ns());
        let possible_ns = taken.filter(|when| when.contains(&tick_ns)).map(|when| when.end).max();
        let possible_ns = possible_ns.unwrap_or(tick_ns);
        Some(from.saturating_sub(possible_ns))
    });
    waits_ns.max().unwrap_or(0) as f64 / 1000.0
}

fn print_comparison(done: &Done, comparison: &Comparison, played: bool) {
    let last = comparison.slips.last().map(|slip| &slip.message);
    println!(
        "slip messages: {}, {} frame numbers left out, {} uneven ticks, late {}, missed transfers {}",
        comparison.slips.len(),
        comparison.skipped,
        comparison.uneven.len(),
        last.map_or(0, |message| message.late_frames),
        comparison.missed_transfers
    );
    println!(
        "against the host: {} compared, {} differ; {} readings were not on the bus, taken from the sensor models",
        comparison.compared,
        comparison.different.len(),
        comparison.from_models
    );
    if let Some(ended) = &comparison.ended {
        println!("  compared up to there: {ended}");
    }
    if played {
        println!(
            "raw messages: {}; counts of {} equal to the episode's, {} not; {} samples equal, {} breaks",
            comparison.raws,
            comparison.taxels_equal,
            comparison.taxels_different.len(),
            comparison.samples_equal,
            comparison.samples_different.len()
        );
        println!(
            "xl_end: {} breaks; as the parts' clocks of {:.1} Hz make samples, within {:.2} of one another",
            comparison.xl_end_different.len(),
            done.xl_rate_hz,
            comparison.xl_clock_spread
        );
    }
    let lists = comparison.differences().into_iter().chain([&comparison.uneven]);
    for line in lists.flat_map(|list| list.iter().take(SHOWN)) {
        println!("  {line}");
    }
}
