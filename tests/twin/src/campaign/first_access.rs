//! Which flipped bits of RAM the core reads: the others need no run.

use std::collections::{BTreeSet, HashMap};

use rigless::emulator::{Access, AccessKind, CoreBus, InterruptLine, Queued};
use rigless::time::VirtualNanos;

/// An access so near to the flip may come before it or after it.
const MARGIN_NS: u64 = 20;

/// Flips that wait for the core's first access to their byte, in a run without a fault.
#[derive(Debug, Default)]
pub struct FirstAccess {
    /// By address: virtual ns of the flip, and its number.
    waiting: HashMap<u64, Vec<(u64, usize)>>,
    /// Numbers of those that were not read before they were overwritten.
    pub unread: BTreeSet<usize>,
}

impl FirstAccess {
    pub fn wait(&mut self, address: u64, flip_ns: u64, number: usize) {
        self.waiting.entry(address).or_default().push((flip_ns, number));
        self.unread.insert(number);
    }

    fn note(&mut self, access: &Access) {
        let now_ns = access.virtual_time.0;
        for address in access.address..access.address + u64::from(access.width.bytes()) {
            let Some(flips) = self.waiting.get_mut(&address) else { continue };
            flips.retain(|&(flip_ns, number)| {
                let is_over = match access.kind {
                    AccessKind::Read => now_ns + MARGIN_NS >= flip_ns,
                    AccessKind::Write => now_ns > flip_ns + MARGIN_NS,
                };
                if is_over && access.kind == AccessKind::Read {
                    self.unread.remove(&number);
                }
                !is_over
            });
        }
    }
}

/// The core's bus, whose accesses are noted.
pub struct Noting<'a> {
    pub bus: &'a mut dyn CoreBus,
    pub first_access: &'a mut FirstAccess,
}

impl CoreBus for Noting<'_> {
    fn access(&mut self, access: Access, from_code: bool) -> Option<u64> {
        self.first_access.note(&access);
        self.bus.access(access, from_code)
    }
    // The rest is the bus's own. The part checks no memory, and no debugger or trace port is there.
    fn time(&self, instructions: u64) -> VirtualNanos {
        self.bus.time(instructions)
    }
    fn queued(&mut self) -> Vec<Queued> {
        self.bus.queued()
    }
    fn carry_on(&mut self, instructions: u64, event: Option<VirtualNanos>) -> Option<u32> {
        self.bus.carry_on(instructions, event)
    }
    fn acknowledge(&mut self, line: InterruptLine, instructions: u64) -> Option<u64> {
        self.bus.acknowledge(line, instructions)
    }
}

#[cfg(test)]
mod tests {
    use rigless::soc::Width;

    use super::*;

    #[test]
    fn what_is_read_before_it_is_overwritten_is_read() {
        let mut first = FirstAccess::default();
        // Overwritten before the flip; after it; read before it; after it; never.
        for number in 0..5 {
            first.wait(100 + number as u64, 1000, number);
        }
        let mut access = |kind, address, width, at_ns| {
            first.note(&Access::new(kind, address, width, 0).at(0, VirtualNanos(at_ns)));
        };
        access(AccessKind::Write, 100, Width::W16, 900);
        access(AccessKind::Read, 102, Width::W8, 900);
        access(AccessKind::Write, 101, Width::W8, 1100);
        access(AccessKind::Read, 100, Width::W16, 1200);
        access(AccessKind::Read, 102, Width::W16, 1300);
        assert_eq!(first.unread, [1, 4].into());
    }
}
