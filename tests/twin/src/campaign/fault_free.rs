//! The run without a fault, and whether a run with one is again what that is.

use std::collections::BTreeMap;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::ops::Range;

use rigless::emulator::{Access, AccessKind, Driver, Error, Host, Settled, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::machine::Twin;

/// Between two digests, virtual ns.
pub const STEP_NS: u64 = 4_000_000;

/// What decides how a run goes on: core, RAM, and all that the core wrote to peripherals or read from them. Left out is
/// what a DMA read from RAM.
#[derive(Debug, Default)]
pub struct FaultFree {
    /// RAM that the firmware uses.
    ram: Vec<Range<u64>>,
    /// By virtual ns, in the run without a fault.
    digests: BTreeMap<u64, u64>,
    until_ns: u64,
    /// Of this run's accesses to peripherals.
    accesses: u64,
    broken: Option<Error>,
}

impl FaultFree {
    /// The driver of the run without a fault.
    pub fn new(ram: Vec<Range<u64>>, until_ns: u64) -> Self {
        Self { ram, until_ns, ..Self::default() }
    }

    /// For the campaign, which starts from the beginning.
    pub fn finish(mut self) -> Result<Self, Error> {
        self.accesses = 0;
        self.broken.take().map_or(Ok(self), Err)
    }

    pub fn note(&mut self, access: Access, value: u64) {
        let mut hasher = DefaultHasher::new();
        let is_write = access.kind == AccessKind::Write;
        (self.accesses, access.address, access.instruction_count, is_write, value).hash(&mut hasher);
        self.accesses = hasher.finish();
    }

    /// Will this run go on as the one without a fault does? `false` between two digests.
    pub fn is_reached(&self, now_ns: u64, host: &mut dyn Host) -> bool {
        let expected = self.digests.get(&now_ns);
        expected.is_some_and(|expected| self.digest(host).is_ok_and(|digest| digest == *expected))
    }

    fn digest(&self, host: &mut dyn Host) -> Result<u64, Error> {
        let mut hasher = DefaultHasher::new();
        self.accesses.hash(&mut hasher);
        host.save_state()?.hash(&mut hasher);
        for span in &self.ram {
            for address in span.clone().step_by(4) {
                host.read(address, Width::W32)?.hash(&mut hasher);
            }
        }
        Ok(hasher.finish())
    }
}

impl Driver<Twin> for FaultFree {
    fn on_settled(&mut self, _: &mut Session<Twin>, _: &mut dyn Host, settled: Settled) {
        if let Settled::Access { access, value } = settled {
            self.note(access, value);
        }
    }

    fn on_stop(&mut self, _: &mut Session<Twin>, stop: Stop, host: &mut dyn Host) -> Option<VirtualNanos> {
        let digest = self.digest(host).map_err(|error| self.broken = Some(error)).ok()?;
        self.digests.insert(stop.at.0, digest);
        let next_ns = (stop.at.0 / STEP_NS + 1) * STEP_NS;
        (next_ns <= self.until_ns).then_some(VirtualNanos(next_ns))
    }
}

#[cfg(test)]
mod tests {
    use rigless::device::Level;
    use rigless::emulator::{InterruptLine, Memory};

    use super::*;

    #[derive(Clone)]
    struct Machine {
        ram: [u64; 4],
        core: Vec<u8>,
    }

    impl Memory for Machine {
        fn read(&mut self, address: u64, _: Width) -> Result<u64, Error> {
            Ok(self.ram[address as usize / 4])
        }
        fn write(&mut self, address: u64, _: Width, value: u64) -> Result<(), Error> {
            self.ram[address as usize / 4] = value;
            Ok(())
        }
    }

    impl Host for Machine {
        fn set_interrupt(&mut self, _: InterruptLine, _: Level) {}
        fn request_reset(&mut self) {}
        fn save_state(&mut self) -> Result<Vec<u8>, Error> {
            Ok(self.core.clone())
        }
    }

    #[test]
    fn reached_only_with_the_same_core_ram_and_accesses() {
        let whole = Machine { ram: [1, 2, 3, 4], core: vec![5] };
        let mut run = FaultFree::new(vec![0..16], 0);
        let write = Access::new(AccessKind::Write, 100, Width::W32, 7);
        run.note(write, 7);
        run.digests.insert(STEP_NS, run.digest(&mut whole.clone()).unwrap());
        let reached = |run: &FaultFree, host: &Machine| run.is_reached(STEP_NS, &mut host.clone());
        assert!(reached(&run, &whole) && !run.is_reached(STEP_NS + 1, &mut whole.clone()));
        assert!(!reached(&run, &Machine { ram: [1, 2, 3, 5], ..whole.clone() }));
        assert!(!reached(&run, &Machine { core: vec![6], ..whole.clone() }));
        run.note(write, 7);
        assert!(!reached(&run, &whole));
    }
}
