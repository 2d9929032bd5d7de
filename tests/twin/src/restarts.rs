//! What a run with restarts took, in virtual time: until the board was back on the bus, and for its files.

use rigless::device::ResetCause;
use slipsense::node::{FILE_READ_PORT, HEARTBEAT_PORT};
use slipsense::wire::{SLIP_PORT, ServiceRole, TransferId};
use slipsense_can_sim::Outcome;

use crate::fdcan::wire::{Logged, MCU, can_frame};
use crate::run::Done;

/// A pause in its requests that ends a file: longer than the erase of a slot.
const PAUSE_NS: u64 = 6_000_000_000;

/// What a frame of the board is, as far as it matters here.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Kind {
    Slip,
    Heartbeat,
    FileRequest,
}

fn kind(logged: &Logged) -> Option<Kind> {
    let frame = can_frame(&logged.frame)?;
    match TransferId::from_can(frame.id()).ok()? {
        TransferId::Message(id) if id.port == SLIP_PORT => Some(Kind::Slip),
        TransferId::Message(id) if id.port == HEARTBEAT_PORT => Some(Kind::Heartbeat),
        TransferId::Service(id) if id.port == FILE_READ_PORT && id.role == ServiceRole::Request => {
            Some(Kind::FileRequest)
        }
        TransferId::Message(_) | TransferId::Service(_) | TransferId::Anonymous(_) => None,
    }
}

/// How often the watchdog restarted the board.
pub fn bites(done: &Done) -> usize {
    done.resets.iter().filter(|(_, cause)| matches!(cause, ResetCause::Model("IWDG"))).count()
}

pub fn print(done: &Done) {
    let sent = done.frames.iter().filter(|logged| logged.node == MCU && logged.outcome == Outcome::Sent);
    let sent: Vec<(Kind, &Logged)> = sent.filter_map(|logged| Some((kind(logged)?, logged))).collect();
    for (index, (at, cause)) in done.resets.iter().enumerate() {
        let until = done.resets.get(index + 1).map_or(u64::MAX, |(next, _)| *next);
        let failure = done.failures.iter().find(|failure| failure.at_ns == *at);
        let why = match (failure, cause) {
            (Some(failure), _) => format!("supply failed at {}", failure.step),
            (None, ResetCause::Core) => "asked for by the program".to_owned(),
            (None, ResetCause::Model(name)) => format!("by the {name}"),
            (None, other) => format!("{other:?}"),
        };
        let first = |wanted: Kind| {
            let found = sent
                .iter()
                .find(|(kind, logged)| *kind == wanted && logged.start_ns > *at && logged.start_ns < until);
            found.map_or_else(
                || "none before the next".to_owned(),
                |(_, logged)| format!("after {:.1} ms", (logged.end_ns - at) as f64 / 1e6),
            )
        };
        println!(
            "restart at {:.3} s, {why}: first slip message {}, first heartbeat {}",
            *at as f64 / 1e9,
            first(Kind::Slip),
            first(Kind::Heartbeat)
        );
    }
    let requests: Vec<u64> = sent
        .iter()
        .filter(|(kind, _)| *kind == Kind::FileRequest)
        .map(|(_, logged)| logged.start_ns)
        .collect();
    let goes_on = |before: &u64, after: &u64| {
        after - before < PAUSE_NS && !done.resets.iter().any(|(at, _)| (before..after).contains(&at))
    };
    for file in requests.chunk_by(goes_on) {
        let (Some(first), Some(last)) = (file.first(), file.last()) else { continue };
        println!(
            "file requests from {:.3} s on: {} in {:.3} s",
            *first as f64 / 1e9,
            file.len(),
            (last - first) as f64 / 1e9
        );
    }
}
