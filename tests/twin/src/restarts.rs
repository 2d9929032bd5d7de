//! What a run with restarts took, in virtual time: until the board was back on the bus, and for its files.

use rigless::device::ResetCause;
use slipsense::node::{FILE_READ_PORT, HEARTBEAT_PORT};
use slipsense::wire::SLIP_PORT;

use crate::fdcan::wire::Logged;
use crate::run::Done;

/// A pause in its requests that ends a file: longer than the erase of a slot.
const PAUSE_NS: u64 = 6_000_000_000;

/// How often the watchdog restarted the board.
pub fn bites(done: &Done) -> usize {
    done.resets.iter().filter(|(_, cause)| matches!(cause, ResetCause::Model("IWDG"))).count()
}

pub fn print(done: &Done) {
    let sent = done.frames.iter().filter(|logged| logged.is_of_board());
    let sent: Vec<(u16, &Logged)> = sent.filter_map(|logged| Some((logged.port()?, logged))).collect();
    let of = |wanted: u16| sent.iter().filter(move |(port, _)| *port == wanted).map(|(_, logged)| *logged);
    for (index, (at, cause)) in done.resets.iter().enumerate() {
        let until = done.resets.get(index + 1).map_or(u64::MAX, |(next, _)| *next);
        let failure = done.failures.iter().find(|failure| failure.at_ns == *at);
        let why = match (failure, cause) {
            (Some(failure), _) => format!("supply failed at {}", failure.step),
            (None, ResetCause::Core) => "asked for by the program".to_owned(),
            (None, ResetCause::Model(name)) => format!("by the {name}"),
            (None, other) => format!("{other:?}"),
        };
        let first = |port: u16| match of(port).find(|sent| sent.start_ns > *at && sent.start_ns < until) {
            Some(logged) => format!("after {:.1} ms", (logged.end_ns - at) as f64 / 1e6),
            None => "none before the next".to_owned(),
        };
        println!(
            "restart at {:.3} s, {why}: first slip message {}, first heartbeat {}",
            *at as f64 / 1e9,
            first(SLIP_PORT),
            first(HEARTBEAT_PORT)
        );
    }
    let requests: Vec<u64> = of(FILE_READ_PORT).map(|logged| logged.start_ns).collect();
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
