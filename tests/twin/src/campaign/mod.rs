//! Fault-injection campaigns. The process runs without a fault and forks at chosen instants; each child injects one fault,
//! goes on, and its exit status is the verdict.

pub mod bit_flips;
pub mod boot_skips;
pub mod fault_free;
pub mod first_access;
pub mod processor;
pub mod results;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use anyhow::{Context, Result};
use nix::libc;
use nix::sys::wait::{WaitStatus, wait};
use nix::unistd::{ForkResult, Pid, alarm, fork};
use rigless::emulator::{Driver, Host, Settled, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::fitted::Fitted;
use crate::flash_wait::FlashWait;
use crate::machine::Twin;
use crate::shared::lock;
use fault_free::FaultFree;
use processor::Handle;
use results::{NO_VERDICT, Results};

/// A child that takes longer, seconds of this computer, is ended.
const LIMIT_S: u32 = 300;

/// After this a child is no longer compared with the run without a fault, which takes time.
const RECOVERS_NS: u64 = 24_000_000;

/// One flipped bit, or one skipped instruction.
#[derive(Clone, Copy, Debug)]
pub enum InjectedFault {
    Register { number: usize, bit: u32 },
    Memory { address: u64, bit: u32 },
    Skip { pc: u64 },
}

#[derive(Clone, Copy, Debug)]
pub struct Planned {
    /// In the campaign.
    pub number: usize,
    pub at_ns: u64,
    pub fault: InjectedFault,
}

/// The verdict of a child after each step; `None`: it goes on.
pub type Judge = Box<dyn FnMut(&mut Session<Twin>, &mut dyn Host, Stop, &Planned) -> Option<u8> + Send>;

/// A board whose processor takes its faults from `injection`; the first stop is at once.
fn session(fitted: &Arc<Fitted>, injection: &Handle) -> Result<Session<Twin>> {
    let mut board = Box::new(Twin::new(fitted)?);
    board.injection = Some(injection.clone());
    Ok(Session::new(board, 0, VirtualNanos(1))?)
}

pub struct Campaign {
    /// By time.
    planned: VecDeque<Planned>,
    core: Handle,
    judge: Judge,
    step_ns: u64,
    /// A child that goes on as this run does has its verdict.
    pub fault_free: Option<(FaultFree, u8)>,
    /// In a child, its fault.
    injected: Option<Planned>,
    running: BTreeMap<Pid, Planned>,
    parallel: usize,
    results: Results,
    wait: FlashWait,
    broken: Option<anyhow::Error>,
}

impl Campaign {
    /// Each child is judged every `step_ns`. What has its verdict in `results` is left out.
    pub fn new(planned: &[Planned], results: Results, core: Handle, step_ns: u64, judge: Judge) -> Self {
        let has_verdict = |planned: &&Planned| results.verdicts.contains_key(&planned.number);
        let mut planned: Vec<_> = planned.iter().filter(|planned| !has_verdict(planned)).copied().collect();
        planned.sort_by_key(|planned| planned.at_ns);
        let parallel = std::thread::available_parallelism().map_or(1, usize::from);
        let (planned, running, injected) = (planned.into(), BTreeMap::new(), None);
        let (wait, broken, fault_free) = (FlashWait::default(), None, None);
        Self { planned, core, judge, step_ns, fault_free, injected, running, parallel, results, wait, broken }
    }

    /// The verdict of each fault, by its number.
    pub fn finish(self) -> Result<BTreeMap<usize, u8>> {
        self.broken.map_or(Ok(self.results.verdicts), Err)
    }

    fn collect(&mut self) -> Result<()> {
        let (pid, verdict) = match wait().context("waiting for a child")? {
            WaitStatus::Exited(pid, status) => (pid, status as u8),
            WaitStatus::Signaled(pid, ..) => (pid, NO_VERDICT),
            _ => return Ok(()),
        };
        if let Some(planned) = self.running.remove(&pid) {
            self.results.add(planned.number, verdict)?;
            let done = self.results.verdicts.len();
            if done.is_multiple_of(100) {
                eprintln!("{done} done, {} to do", self.planned.len() + self.running.len());
            }
        }
        Ok(())
    }

    /// Fork for each fault that is due.
    fn fork(&mut self, stop: Stop, host: &mut dyn Host) -> Result<()> {
        while let Some(planned) = self.planned.pop_front_if(|planned| planned.at_ns <= stop.at.0) {
            while self.running.len() >= self.parallel {
                self.collect()?;
            }
            // SAFETY: the other threads of this process wait for this one, and hold nothing that a child needs.
            match unsafe { fork() }.context("cannot fork")? {
                ForkResult::Parent { child } => {
                    self.running.insert(child, planned);
                }
                ForkResult::Child => {
                    alarm::set(LIMIT_S);
                    self.injected = Some(planned);
                    return inject(planned.fault, &self.core, host);
                }
            }
        }
        Ok(())
    }
}

fn inject(fault: InjectedFault, core: &Handle, host: &mut dyn Host) -> Result<()> {
    match fault {
        InjectedFault::Register { number, bit } => lock(core).flip = Some((number, 1 << bit)),
        InjectedFault::Memory { address, bit } => {
            let held = host.read(address, Width::W8)?;
            host.write(address, Width::W8, held ^ 1 << bit)?;
        }
        InjectedFault::Skip { pc } => {
            // The first halfword of a long instruction begins with 0b11101 or above (ARM DDI 0403, A5.1).
            let long = host.read(pc, Width::W16)? >> 11 >= 0b11101;
            lock(core).jump_to = Some(pc + if long { 4 } else { 2 });
        }
    }
    Ok(())
}

impl Driver<Twin> for Campaign {
    fn on_settled(&mut self, session: &mut Session<Twin>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, value } => {
                self.wait.look(host, access, value);
                if let Some((fault_free, _)) = &mut self.fault_free {
                    fault_free.note(access, value);
                }
            }
            Settled::Stop(stop) => self.wait.settle(session, host, stop.at),
            _ => {}
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Twin>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        if self.injected.is_none()
            && let Err(error) = self.fork(stop, host)
        {
            self.broken = Some(error);
            return None;
        }
        if let Some(injected) = &self.injected {
            let is_recent = stop.at.0 <= injected.at_ns + RECOVERS_NS;
            let compared = self.fault_free.as_ref().filter(|_| is_recent);
            let reached = compared.filter(|(run, _)| run.is_reached(stop.at.0, host));
            let verdict = reached.map(|(_, verdict)| *verdict);
            if let Some(verdict) = verdict.or_else(|| (self.judge)(session, host, stop, injected)) {
                // SAFETY: a child has nothing to clean up.
                unsafe { libc::_exit(verdict.into()) }
            }
            return Some(VirtualNanos((stop.at.0 / self.step_ns + 1) * self.step_ns));
        }
        if let Some(next) = self.planned.front() {
            return Some(VirtualNanos(next.at_ns));
        }
        while !self.running.is_empty() && self.broken.is_none() {
            self.broken = self.collect().err();
        }
        None
    }
}
