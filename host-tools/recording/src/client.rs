//! Calls to a module on a live bus, its registers and commands, while everything else on the bus goes on to whoever
//! wants it; and the registers that others on the bus read.

use std::collections::HashMap;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail, ensure};
use slipsense::calibration::State;
use slipsense::node::{ACCESS_PORT, CALIBRATE, COMMAND_PORT};
use slipsense::wire::{CanFrame, Frames, NodeId, Priority, ServiceId, ServiceRole, Sessions, TransferId};

use crate::candump::LogEntry;
use crate::link::{Input, Source, now_us};

/// A node answers within this time; a store may take an erase of its flash.
pub const ANSWER: Duration = Duration::from_secs(10);
/// How often a measurement that goes on is looked at.
const LOOK: Duration = Duration::from_millis(500);

/// A bus, and who gets the frames that a call does not wait for.
pub struct Bus<'b> {
    pub source: &'b mut Source,
    pub others: &'b mut dyn FnMut(&LogEntry) -> Result<()>,
}

impl Bus<'_> {
    /// Pass frames on until one of them is what is waited for. `None`: it did not come in time.
    fn wait<T>(
        &mut self,
        time: Duration,
        mut wanted: impl FnMut(&CanFrame) -> Option<T>,
    ) -> Result<Option<T>> {
        let deadline = Instant::now() + time;
        while Instant::now() < deadline {
            match self.source.receive()? {
                Input::Frame(entry) => {
                    let found = wanted(&entry.frame);
                    (self.others)(&entry)?;
                    if found.is_some() {
                        return Ok(found);
                    }
                }
                Input::End => bail!("the bus is gone"),
                Input::Other(_) | Input::Idle => {}
            }
        }
        Ok(None)
    }
}

/// Who calls one node.
pub struct Client {
    own: NodeId,
    node: NodeId,
    transfer: u8,
}

impl Client {
    /// `own` must be no other node's address. The first transfer is numbered by the clock: a node takes what it has had
    /// within two seconds, with the same number, for a repetition, and does not answer.
    pub fn new(own: NodeId, node: NodeId) -> Self {
        Self { own, node, transfer: (now_us() / 100_000 % 32) as u8 }
    }

    /// The frames of the next request.
    fn request(&mut self, port: u16, payload: &[u8]) -> (ServiceId, Vec<CanFrame>) {
        let (priority, role) = (Priority::Nominal, ServiceRole::Request);
        let id = ServiceId { priority, role, port, destination: self.node, source: self.own };
        self.transfer = (self.transfer + 1) % 32;
        (id, Frames::new(id, self.transfer, payload).collect())
    }

    /// The frames of a request for a register, whose answer [`Reads`] sees.
    pub fn read(&mut self, name: &str) -> Vec<CanFrame> {
        self.request(ACCESS_PORT, &access(name)).1
    }

    fn call(&mut self, bus: &mut Bus<'_>, port: u16, payload: &[u8]) -> Result<Vec<u8>> {
        let (id, frames) = self.request(port, payload);
        for frame in frames {
            bus.source.send(&frame)?;
        }
        let (wanted, mut sessions) =
            (TransferId::Service(id.response()), Box::new(Sessions::<1, 640>::new()));
        let answer = bus.wait(ANSWER, |frame| {
            if frame.id() != wanted.to_can() {
                return None;
            }
            let arrived = sessions.accept(wanted, frame, 0).ok().flatten()?;
            (arrived.transfer == self.transfer).then(|| arrived.payload.to_vec())
        })?;
        answer.with_context(|| format!("node {} does not answer", self.node.get()))
    }

    /// `uavcan.node.ExecuteCommand`.
    pub fn command(&mut self, bus: &mut Bus<'_>, command: u16, parameter: &str) -> Result<()> {
        let payload = [&command.to_le_bytes()[..], &[parameter.len() as u8], parameter.as_bytes()].concat();
        let answer = self.call(bus, COMMAND_PORT, &payload)?;
        let why = answer.get(2..).map(String::from_utf8_lossy).unwrap_or_default();
        let (node, why) = (self.node.get(), why.trim_end_matches('\0'));
        ensure!(answer.first() == Some(&0), "node {node} refuses: {why}");
        Ok(())
    }

    /// The numbers in a register of natural16 or natural32.
    pub fn register(&mut self, bus: &mut Bus<'_>, name: &str) -> Result<Vec<u64>> {
        let answer = self.call(bus, ACCESS_PORT, &access(name))?;
        numbers(&answer)
            .with_context(|| format!("node {}: {name} is not there: an older firmware?", self.node.get()))
    }

    /// Let the module measure an array (`CALIBRATE`, seconds) or change its gains, and wait; `seen` hears of each frame
    /// count on the way.
    pub fn calibrate(
        &mut self,
        bus: &mut Bus<'_>,
        sensor: u8,
        (command, number): (u16, u16),
        seen: &mut dyn FnMut(u64),
    ) -> Result<()> {
        self.command(bus, command, &format!("{sensor} {number}"))?;
        let seconds = if command == CALIBRATE { number } else { 0 };
        let deadline = Instant::now() + Duration::from_secs(seconds.into()) + ANSWER;
        loop {
            bus.wait(LOOK, |_| None::<()>)?;
            let numbers = self.register(bus, "slipsense.status.measurement")?;
            let &[_, state, frames, wanted, row, col] = &numbers[..] else {
                bail!("node {}: no such measurement: {numbers:?}", self.node.get());
            };
            seen(frames);
            let is = |other: State| state == other as u64;
            if is(State::Done) {
                return Ok(());
            }
            let at = format!("sensor {sensor}, row {row}, column {col} of the scan");
            ensure!(!is(State::Touched), "{at}: touched while it was measured; lift everything off");
            ensure!(!is(State::Faulty), "{at} is the first of too many taxels out of order");
            ensure!(!is(State::TooShort), "sensor {sensor}: no whole second of scans came");
            ensure!(!is(State::NotStored), "sensor {sensor}: the flash refused the calibration");
            ensure!(!is(State::Gain), "sensor {sensor}: a gain would be 0, or 2 and more");
            ensure!(Instant::now() < deadline, "{frames} of {wanted} frames, then nothing more");
        }
    }
}

/// A request of `uavcan.register.Access` that reads.
fn access(name: &str) -> Vec<u8> {
    [&[name.len() as u8], name.as_bytes(), &[0]].concat()
}

/// Of an answer of `uavcan.register.Access`: natural16 or natural32.
fn numbers(answer: &[u8]) -> Option<Vec<u64>> {
    let (bytes, elements) = match answer.get(8..)? {
        [9, count, rest @ ..] => (4, rest.get(..4 * usize::from(*count))?),
        [10, count, rest @ ..] => (2, rest.get(..2 * usize::from(*count))?),
        _ => return None,
    };
    let number = |bytes: &[u8]| bytes.iter().rev().fold(0, |number, &byte| number << 8 | u64::from(byte));
    Some(elements.chunks(bytes).map(number).collect())
}

/// The registers that somebody on the bus reads, and what the modules answer.
#[derive(Default)]
pub struct Reads {
    sessions: Box<Sessions<16, 640>>,
    /// Of which register the answer will be: by client, node and transfer.
    asked: HashMap<(u8, u8, u8), String>,
}

impl Reads {
    /// Take a frame; `Some` when it completes an answer: node, register, numbers.
    pub fn accept(&mut self, frame: &CanFrame, now_us: u64) -> Option<(NodeId, String, Vec<u64>)> {
        let id = TransferId::from_can(frame.id()).ok();
        let Some(TransferId::Service(service @ ServiceId { port: ACCESS_PORT, .. })) = id else {
            return None;
        };
        let arrived = self.sessions.accept(TransferId::Service(service), frame, now_us).ok().flatten()?;
        let (from, to, transfer) = (service.source, service.destination, arrived.transfer);
        match service.role {
            ServiceRole::Request => {
                let (&length, name) = arrived.payload.split_first()?;
                let name = String::from_utf8(name.get(..length.into())?.to_vec()).ok()?;
                self.asked.insert((from.get(), to.get(), transfer), name);
                None
            }
            ServiceRole::Response => {
                let name = self.asked.remove(&(to.get(), from.get(), transfer))?;
                Some((from, name, numbers(arrived.payload)?))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_command_again_is_no_repetition() {
        let first = || Client::new(NodeId::new(126).unwrap(), NodeId::DEFAULT).read("a");
        let before = first();
        std::thread::sleep(Duration::from_millis(110));
        assert_ne!(before, first());
    }
}
