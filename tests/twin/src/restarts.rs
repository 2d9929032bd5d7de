//! What a run with restarts took, in virtual time: until the node was back on the bus, and for its files.

use slipsense::node::{FILE_READ_PORT, HEARTBEAT_PORT};
use slipsense::wire::{ServiceRole, TransferId};
use slipsense_can_model::Outcome;

use crate::compare::can_frame;
use crate::fdcan::wire::{Logged, MCU};
use crate::run::Done;

/// A pause in its requests that ends a file: longer than the erase of a slot, three sectors.
const PAUSE_NS: u64 = 5_000_000_000;

/// Print each restart and each file.
pub fn print(done: &Done) {
    let sent = |logged: &&Logged| logged.node == MCU && logged.outcome == Outcome::Sent;
    let id =
        |logged: &Logged| can_frame(&logged.frame).and_then(|frame| TransferId::from_can(frame.id()).ok());
    let heartbeat =
        |logged: &Logged| matches!(id(logged), Some(TransferId::Message(id)) if id.port == HEARTBEAT_PORT);
    let request = |logged: &Logged| {
        let wanted = |id| matches!(id, TransferId::Service(id) if id.port == FILE_READ_PORT && id.role == ServiceRole::Request);
        id(logged).is_some_and(wanted)
    };
    for &at in &done.resets {
        let failure = done.failures.iter().find(|failure| failure.at_ns == at);
        let why =
            failure.map_or("asked for".to_owned(), |failure| format!("supply failed at {}", failure.step));
        let back = done.frames.iter().filter(sent).find(|logged| logged.start_ns > at && heartbeat(logged));
        let again = done.resets.iter().find(|&&next| next > at);
        match back.filter(|back| again.is_none_or(|&next| back.start_ns < next)) {
            Some(back) => {
                let ms = (back.end_ns - at) as f64 / 1e6;
                println!("restart at {:.3} s, {why}: first heartbeat after {ms:.1} ms", at as f64 / 1e9);
            }
            None => println!("restart at {:.3} s, {why}: no heartbeat before the next", at as f64 / 1e9),
        }
    }
    let requests: Vec<u64> = done
        .frames
        .iter()
        .filter(sent)
        .filter(|logged| request(logged))
        .map(|logged| logged.start_ns)
        .collect();
    let goes_on = |before: &u64, after: &u64| {
        after - before < PAUSE_NS && !done.resets.iter().any(|at| (before..after).contains(&at))
    };
    for file in requests.chunk_by(goes_on) {
        let (Some(first), Some(last)) = (file.first(), file.last()) else { continue };
        println!(
            "file from {:.3} s on: {} requests in {:.3} s",
            *first as f64 / 1e9,
            file.len(),
            (last - first) as f64 / 1e9
        );
    }
}
