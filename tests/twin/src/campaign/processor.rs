//! The emulated processor with faults injected between two instructions, and with a trace of what it executes.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::{Arc, Mutex};

use rigless::emulator::{CoreBus, CoreSpec, DataModel, Error, Exit, Processor, Queued};
use rigless::soc::{Endian, Width};
use rigless::time::VirtualNanos;

use super::first_access::{FirstAccess, Noting};
use crate::shared::lock;

/// What GDB numbers `pc`.
pub const PC: usize = 15;
/// r0 to r12, sp, lr, pc, xPSR, and then d0 to d15.
pub const REGISTERS: usize = 33;

/// Where ITCM begins.
const ITCM: u64 = 0;

/// By address, how many instructions were executed before it was for the first and for the last time.
type Trace = BTreeMap<u64, [u64; 2]>;

/// Faults for the processor, and what it reports.
#[derive(Debug, Default)]
pub struct Injection {
    /// Before the next instruction: number of a register, and the bits of it to flip.
    pub flip: Option<(usize, u64)>,
    /// Address to go to in place of the next instruction.
    pub jump_to: Option<u64>,
    /// Address of the next instruction.
    pub pc: u64,
    /// `None`: no trace, which is many times faster.
    pub trace: Option<Trace>,
    /// `None`: the core's accesses to RAM are not noted, which is many times faster. Not to be changed during a run.
    pub first_access: Option<FirstAccess>,
}

pub type Handle = Arc<Mutex<Injection>>;

#[derive(Debug)]
struct FaultyProcessor {
    core: Box<dyn Processor>,
    /// Never runs.
    spare: Box<dyn Processor>,
    injection: Handle,
}

/// This core, which takes its faults from `injection`.
pub fn injected(mut spec: CoreSpec, injection: &Handle) -> CoreSpec {
    let (make, injection) = (spec.processor.clone(), injection.clone());
    spec.processor = Arc::new(move |endian| {
        let (core, spare) = (make(endian)?, make(endian)?);
        Ok(Box::new(FaultyProcessor { core, spare, injection: injection.clone() }) as Box<dyn Processor>)
    });
    spec
}

impl FaultyProcessor {
    /// Inject what is due; take the trace out.
    fn inject(&mut self) -> Option<Trace> {
        let (flip, jump_to, trace) = {
            let mut injection = lock(&self.injection);
            (injection.flip.take(), injection.jump_to.take(), injection.trace.take())
        };
        if let Some((register, bits)) = flip {
            let mut held = self.core.gdb_register(register).expect("a register of the core");
            held.iter_mut().zip(bits.to_le_bytes()).for_each(|(held, bits)| *held ^= bits);
            self.set(register, &held);
        }
        if let Some(at) = jump_to {
            self.set(PC, &(at as u32).to_le_bytes());
        }
        trace
    }

    /// By way of the spare core: after a write to one of its registers a core translates all its code again, which takes
    /// seconds. A state with the written register that no core can load is written.
    fn set(&mut self, register: usize, bytes: &[u8]) {
        let (core, spare) = (&mut self.core, &mut self.spare);
        let loaded = spare.load(&core.save()).is_ok()
            && spare.set_gdb_register(register, bytes)
            && core.load(&spare.save()).is_ok();
        assert!(loaded || core.set_gdb_register(register, bytes), "register {register} can be set");
    }

    fn step(&mut self, budget: u32, bus: &mut dyn CoreBus, trace: &mut Trace) -> (Exit, u64) {
        let mut all = 0;
        loop {
            let (pc, before) = (self.core.pc(), self.core.retired());
            let (exit, done) = self.core.run(1, bus);
            if done > 0 {
                trace.entry(pc).or_insert([before, before])[1] = before;
            }
            all += done;
            if exit != Exit::Budget || all >= u64::from(budget) {
                return (exit, all);
            }
        }
    }
}

impl Processor for FaultyProcessor {
    fn run(&mut self, budget: u32, bus: &mut dyn CoreBus) -> (Exit, u64) {
        let trace = self.inject();
        let first_access = lock(&self.injection).first_access.take();
        let ran = match (trace, first_access) {
            (Some(mut trace), _) => {
                let ran = self.step(budget, bus, &mut trace);
                lock(&self.injection).trace = Some(trace);
                ran
            }
            (None, Some(mut first_access)) => {
                let ran = self.core.run(budget, &mut Noting { bus, first_access: &mut first_access });
                lock(&self.injection).first_access = Some(first_access);
                ran
            }
            (None, None) => self.core.run(budget, bus),
        };
        lock(&self.injection).pc = self.core.pc();
        ran
    }

    // The rest is the core's own. What only a debugger, a watch or semihosting asks for is left out: no campaign has one.
    fn retired(&self) -> u64 {
        self.core.retired()
    }
    fn ask(&mut self, queued: Queued) {
        self.core.ask(queued);
    }
    fn maps(&self, start: u64, length: u64) -> bool {
        self.core.maps(start, length)
    }
    fn page_size(&self) -> u64 {
        self.core.page_size()
    }
    unsafe fn map(&mut self, start: u64, length: u64, host: *mut u8, writable: bool) {
        // What the core does not have mapped it asks the bus for, RAM too. It runs code from ITCM, which the bus cannot give it.
        if !writable || start == ITCM || lock(&self.injection).first_access.is_none() {
            // SAFETY: the caller promises the same to us.
            unsafe { self.core.map(start, length, host, writable) }
        }
    }
    fn boot(&mut self, table: u64, read: &dyn Fn(u64, Width) -> Option<u64>) {
        self.core.boot(table, read);
    }
    fn reset(&mut self) {
        self.core.reset();
    }
    fn take_reset_request(&mut self) -> bool {
        self.core.take_reset_request()
    }
    fn next_event(&self) -> Option<VirtualNanos> {
        self.core.next_event()
    }
    fn on_event(&mut self, now: VirtualNanos) {
        self.core.on_event(now);
    }
    fn waiting(&self) -> bool {
        self.core.waiting()
    }
    fn pc(&self) -> u64 {
        self.core.pc()
    }
    fn data_model(&self) -> DataModel {
        self.core.data_model()
    }
    fn byte_order(&self, address: u64) -> Endian {
        self.core.byte_order(address)
    }
    fn save(&self) -> Vec<u8> {
        self.core.save()
    }
    fn load(&mut self, bytes: &[u8]) -> Result<(), Error> {
        self.core.load(bytes)
    }
    fn own_ranges(&self) -> Vec<Range<u64>> {
        self.core.own_ranges()
    }
    fn answer_host_call(&mut self, answer: Option<u64>) {
        self.core.answer_host_call(answer);
    }
}
