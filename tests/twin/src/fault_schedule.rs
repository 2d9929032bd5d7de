//! Every fault in one run, one after the other, and what each must show and must leave alone.

use slipsense::health;

use crate::fault_injection::{Fault, Kind, NAMES};
use crate::recovery::{Recovery, names};

/// Before the first, and after each: longer than an accelerometer takes to start.
const REST_NS: u64 = 200_000_000;

/// How long a fault lasts, flags that it must show, flags that may come with them, and whether every frame must have
/// its slip message on the bus all the while.
struct Expectation {
    lasts_ns: u64,
    shows: u8,
    may_show: u8,
    every_message: bool,
}

const fn expectation(kind: Kind) -> Expectation {
    // Samples of a part that starts again fill a window first.
    let with_xl = health::XL_WARMING_UP | health::XL_SAMPLES_DROPPED;
    let (lasts_ms, shows, may_show, every_message) = match kind {
        Kind::ErrorFrames { per_million } if per_million < 1_000_000 => (400, 0, 0, true),
        Kind::Flood => (200, 0, 0, true),
        // It tries two signatures, a second apart.
        Kind::Hostile => (1100, 0, 0, true),
        Kind::AccelerometerStops => (100, health::XL_MISSING, with_xl, true),
        // What is left of the samples is delivered; the gap before them is flagged.
        Kind::FifoOverrun => (100, health::XL_SAMPLES_DROPPED, with_xl, true),
        // All taxels alike for 100 ms make an array dead.
        Kind::AdcStuck => (250, health::PIEZO_MISSING, 0, true),
        // Nobody receives the flag.
        Kind::ErrorFrames { .. } | Kind::NoAcknowledge => (200, 0, 0, false),
    };
    Expectation { lasts_ns: lasts_ms * 1_000_000, shows, may_show, every_message }
}

/// All of them at least once. Those that leave every slip message on the bus are repeated, so that the run takes about
/// `seconds`; those that do not come last, because after them nothing can be compared.
pub fn schedule(seconds: f64) -> Vec<Fault> {
    let mut last = NAMES.to_vec();
    let repeated: Vec<_> = last.extract_if(.., |(_, kind)| expectation(*kind).every_message).collect();
    let lasts_ns = |kinds: &[(_, Kind)]| -> u64 {
        kinds.iter().map(|(_, kind)| expectation(*kind).lasts_ns + REST_NS).sum()
    };
    let until_ns = ((seconds * 1e9) as u64).saturating_sub(REST_NS + lasts_ns(&last));
    let rounds = (until_ns / lasts_ns(&repeated)).max(1) as usize;
    let mut start = REST_NS;
    std::iter::repeat_n(repeated, rounds)
        .flatten()
        .chain(last)
        .map(|(name, kind)| {
            let end = start + expectation(kind).lasts_ns;
            let fault = Fault { name, kind, when: start..end };
            start = end + REST_NS;
            fault
        })
        .collect()
}

/// Virtual seconds of a run of them.
pub fn seconds(schedule: &[Fault]) -> f64 {
    schedule.last().map_or(0, |last| last.when.end + REST_NS) as f64 / 1e9
}

pub fn complaints(recoveries: &[Recovery]) -> Vec<String> {
    let mut complaints = Vec::new();
    for &Recovery { ref fault, flags, left_out, failed, heartbeats, healthy_ns, .. } in recoveries {
        let Expectation { shows, may_show, every_message, .. } = expectation(fault.kind);
        let (hidden, others) = (shows & !flags, flags & !(shows | may_show));
        let found = [
            (hidden != 0, format!("does not show {}", names(hidden))),
            (others != 0, format!("shows {} too", names(others))),
            (every_message && left_out > 0, format!("{left_out} frames without a slip message")),
            (!every_message && failed == 0, "no frame failed".to_owned()),
            (fault.kind == Kind::Hostile && heartbeats == 0, "no heartbeat".to_owned()),
            (healthy_ns.is_none(), "did not recover before the next".to_owned()),
        ];
        let found = found.into_iter().filter(|(is_so, _)| *is_so);
        complaints.extend(found.map(|(_, what)| format!("{}: {what}", fault.name)));
    }
    complaints
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sound() -> Vec<Recovery> {
        let recovery = |fault: Fault| {
            let expectation = expectation(fault.kind);
            Recovery {
                flags: expectation.shows,
                messages: 24,
                left_out: 0,
                failed: usize::from(!expectation.every_message),
                heartbeats: 1,
                first_ns: Some(1),
                healthy_ns: Some(1),
                fault,
            }
        };
        schedule(0.0).into_iter().map(recovery).collect()
    }

    #[test]
    fn every_fault_has_its_turn_and_time_to_recover() {
        let schedule = schedule(0.0);
        assert_eq!(schedule.len(), NAMES.len());
        assert!(schedule.windows(2).all(|pair| pair[1].when.start == pair[0].when.end + REST_NS));
        assert_eq!(complaints(&sound()), Vec::<String>::new());
        let hour = super::schedule(3600.0);
        assert!((3590.0..=3600.0).contains(&seconds(&hour)), "{}", seconds(&hour));
        assert!(NAMES.iter().all(|(name, _)| hour.iter().any(|fault| fault.name == *name)));
    }

    #[test]
    fn what_is_not_as_it_must_be_is_told() {
        let spoil: [fn(&mut Recovery); 4] = [
            |recovery| recovery.flags ^= health::XL_MISSING,
            |recovery| recovery.flags |= health::TAXELS_SATURATED,
            |recovery| recovery.left_out += 1,
            |recovery| recovery.healthy_ns = None,
        ];
        for (spoil, said) in spoil.into_iter().zip(["XL_MISSING", "TAXELS_SATURATED", "without", "recover"]) {
            let mut recoveries = sound();
            let xl = recoveries.iter_mut().find(|recovery| recovery.fault.kind == Kind::FifoOverrun);
            spoil(xl.expect("it is one of them"));
            let found = complaints(&recoveries);
            assert!(matches!(&found[..], [one] if one.contains(said)), "{found:?}");
        }
    }
}
