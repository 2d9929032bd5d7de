//! What each fault of a run did to the slip messages, and how long until all was as before.

use slipsense::health;
use slipsense::node::HEARTBEAT_PORT;
use slipsense_can_sim::Outcome;

use crate::compare::Slip;
use crate::fault_injection::{Fault, Faults};
use crate::fdcan::wire::{Logged, MCU};
use crate::run::Done;

#[derive(Clone, Debug)]
pub struct Recovery {
    pub fault: Fault,
    /// Slip messages that ended on the bus meanwhile, and frames that had none, until the first one after it.
    pub messages: usize,
    pub left_out: usize,
    /// Flags that they and those after them showed, and that the last one before had not.
    pub flags: u8,
    /// Frames that were cut off by an error or not acknowledged.
    pub failed: usize,
    pub heartbeats: usize,
    /// From its end to the first slip message, and to the first of those that show no new flag any more, ns.
    pub first_ns: Option<u64>,
    pub healthy_ns: Option<u64>,
}

fn flags(slip: &Slip) -> u8 {
    slip.message.contact.iter().fold(0, |flags, contact| flags | contact.health)
}

impl Recovery {
    /// Of each fault, up to the beginning of the next.
    pub fn of_run(done: &Done, faults: &Faults, slips: &[Slip]) -> Vec<Self> {
        let of = |fault: &Fault| {
            let until = faults.after(fault.when.start).first().map_or(u64::MAX, |next| next.when.start);
            let from = slips.partition_point(|slip| slip.end_ns < fault.when.start);
            let end = slips.partition_point(|slip| slip.end_ns < fault.when.end);
            let next = slips.partition_point(|slip| slip.end_ns < until).max(end);
            let before = from.checked_sub(1).map(|last| &slips[last]);
            let new = |slip: &Slip| flags(slip) & !before.map_or(0, flags);
            let after = slips[end..next].first();
            let numbers = before.zip(after).map(|(one, two)| two.message.sequence - one.message.sequence - 1);
            let ill = slips[end..next].iter().rposition(|slip| new(slip) != 0).map_or(0, |last| last + 1);
            let since = |slip: &Slip| slip.end_ns - fault.when.end;
            let started = |at: u64| done.frames.partition_point(|logged| logged.start_ns < at);
            let is_heartbeat = |logged: &&Logged| logged.node == MCU && logged.port() == Some(HEARTBEAT_PORT);
            let meanwhile = &done.frames[started(fault.when.start)..started(fault.when.end)];
            Self {
                fault: fault.clone(),
                messages: end - from,
                left_out: numbers.map_or(0, |numbers| (numbers as usize).saturating_sub(end - from)),
                flags: slips[from..next].iter().fold(0, |flags, slip| flags | new(slip)),
                failed: meanwhile.iter().filter(|logged| logged.outcome != Outcome::Sent).count(),
                heartbeats: meanwhile.iter().filter(is_heartbeat).count(),
                first_ns: after.map(since),
                healthy_ns: slips[end..next].get(ill).map(since),
            }
        };
        faults.all().iter().map(of).collect()
    }

    /// Both as one: sums of messages and frames, the longest times.
    fn with(mut self, other: &Self) -> Self {
        self.messages += other.messages;
        self.left_out += other.left_out;
        self.failed += other.failed;
        self.heartbeats += other.heartbeats;
        self.flags |= other.flags;
        // `None`, never, is the longest.
        let longer = |one: Option<u64>, two: Option<u64>| one.zip(two).map(|(one, two)| one.max(two));
        self.first_ns = longer(self.first_ns, other.first_ns);
        self.healthy_ns = longer(self.healthy_ns, other.healthy_ns);
        self
    }

    fn row(&self, times: usize) -> String {
        let ms = |ns: Option<u64>| ns.map_or("never".to_owned(), |ns| format!("{:.3}", ns as f64 / 1e6));
        let when = &self.fault.when;
        format!(
            "{:<11} {times:>6} {:>8.3} {:>8.3} {:>8} {:>8} {:>8} {:>10} {:>10}  {}",
            self.fault.name,
            when.start as f64 / 1e9,
            (when.end - when.start) as f64 / 1e9,
            self.messages,
            self.left_out,
            self.failed,
            ms(self.first_ns),
            ms(self.healthy_ns),
            names(self.flags)
        )
    }
}

/// A line for each kind and duration, if there are any, at the time of the first.
pub fn print(recoveries: &[Recovery]) {
    if recoveries.is_empty() {
        return;
    }
    println!(
        "{:<11} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8} {:>10} {:>10}  flags",
        "fault", "times", "at s", "lasts s", "flags on", "frames", "attempts", "first flag", "healthy"
    );
    println!(
        "{:<11} {:>6} {:>8} {:>8} {:>8} {:>8} {:>8} {:>10} {:>10}",
        "", "", "first", "each", "the bus", "without", "failed", "ms after", "ms after"
    );
    let mut kinds: Vec<(usize, Recovery)> = Vec::new();
    for recovery in recoveries {
        match kinds.iter_mut().find(|(_, of)| of.fault.is_like(&recovery.fault)) {
            Some((times, of)) => (*times, *of) = (*times + 1, of.clone().with(recovery)),
            None => kinds.push((1, recovery.clone())),
        }
    }
    kinds.iter().for_each(|(times, recovery)| println!("{}", recovery.row(*times)));
}

/// Of health bits.
pub fn names(flags: u8) -> String {
    let known = [
        (health::PIEZO_MISSING, "PIEZO_MISSING"),
        (health::XL_MISSING, "XL_MISSING"),
        (health::XL_WARMING_UP, "XL_WARMING_UP"),
        (health::XL_CLIPPED, "XL_CLIPPED"),
        (health::TAXELS_SATURATED, "TAXELS_SATURATED"),
        (health::XL_SAMPLES_DROPPED, "XL_SAMPLES_DROPPED"),
        (health::NO_MODEL, "NO_MODEL"),
        (health::TAXELS_MASKED, "TAXELS_MASKED"),
    ];
    let set: Vec<&str> = known.iter().filter(|(flag, _)| flags & flag != 0).map(|(_, name)| *name).collect();
    if set.is_empty() { "none".to_owned() } else { set.join(" ") }
}
