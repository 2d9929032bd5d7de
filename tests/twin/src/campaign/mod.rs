//! Many runs that are one until something changes in the core or in RAM: the process is copied there, the copy goes on
//! with the change and judges what became of it, and the process goes on without.

pub mod bit_flips;
pub mod boot_skips;
pub mod core;

use std::collections::{BTreeMap, VecDeque};

use anyhow::{Context, Result};
use nix::libc;
use nix::sys::wait::{WaitStatus, wait};
use nix::unistd::{ForkResult, Pid, alarm, fork};
use rigless::emulator::{Driver, Host, Settled, Stop};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::time::VirtualNanos;

use crate::flash_wait::FlashWait;
use crate::machine::{Fitted, Twin};
use core::{Handle, lock};

/// A copy that takes longer, seconds of this computer, is ended.
const LIMIT_S: u32 = 300;
/// The status of a copy that was ended, or ended by itself: the emulator gave up.
pub const NO_VERDICT: u8 = 0;

/// One bit, or one instruction.
#[derive(Clone, Copy, Debug)]
pub enum Change {
    Register { number: usize, bit: u32 },
    Memory { address: u64, bit: u32 },
    Skip { pc: u64 },
}

#[derive(Clone, Copy, Debug)]
pub struct Planned {
    pub at_ns: u64,
    pub change: Change,
}

/// What a copy says of itself after each step; nothing: it goes on.
pub type Judge = Box<dyn FnMut(&mut Session<Twin>, Stop, &Planned) -> Option<u8> + Send>;

/// The board, with the other end of its core in `exchange`; the first stop is at once.
fn session(fitted: &Fitted, exchange: &Handle) -> Result<Session<Twin>> {
    let mut board = Box::new(Twin::new(fitted)?);
    board.exchange = Some(exchange.clone());
    Ok(Session::new(board, 0, VirtualNanos(1))?)
}

pub struct Campaign {
    /// By time.
    planned: VecDeque<Planned>,
    core: Handle,
    judge: Judge,
    step_ns: u64,
    /// In a copy, what changed there.
    changed: Option<Planned>,
    running: BTreeMap<Pid, Planned>,
    parallel: usize,
    verdicts: Vec<(Planned, u8)>,
    wait: FlashWait,
    broken: Option<anyhow::Error>,
}

impl Campaign {
    /// Each copy is judged every `step_ns`.
    pub fn new(mut planned: Vec<Planned>, core: Handle, step_ns: u64, judge: Judge) -> Self {
        planned.sort_by_key(|planned| planned.at_ns);
        let parallel = std::thread::available_parallelism().map_or(1, usize::from);
        let (running, verdicts) = (BTreeMap::new(), Vec::new());
        let (planned, changed, wait, broken) = (planned.into(), None, FlashWait::default(), None);
        Self { planned, core, judge, step_ns, changed, running, parallel, verdicts, wait, broken }
    }

    /// What became of each, once the run is over.
    pub fn finish(self) -> Result<Vec<(Planned, u8)>> {
        self.broken.map_or(Ok(self.verdicts), Err)
    }

    fn collect(&mut self) -> Result<()> {
        let (pid, verdict) = match wait().context("waiting for a copy of the twin")? {
            WaitStatus::Exited(pid, status) => (pid, status as u8),
            WaitStatus::Signaled(pid, ..) => (pid, NO_VERDICT),
            _ => return Ok(()),
        };
        if let Some(planned) = self.running.remove(&pid) {
            self.verdicts.push((planned, verdict));
            if self.verdicts.len().is_multiple_of(100) {
                eprintln!("{} done, {} to do", self.verdicts.len(), self.planned.len() + self.running.len());
            }
        }
        Ok(())
    }

    /// Copies the process here, for each that is due. `true` in a copy.
    fn copy(&mut self, stop: Stop, host: &mut dyn Host) -> Result<bool> {
        while let Some(planned) = self.planned.pop_front_if(|planned| planned.at_ns <= stop.at.0) {
            while self.running.len() >= self.parallel {
                self.collect()?;
            }
            // SAFETY: the other threads of this process wait for this one, and hold nothing that a copy needs.
            match unsafe { fork() }.context("copying the twin")? {
                ForkResult::Parent { child } => {
                    self.running.insert(child, planned);
                }
                ForkResult::Child => {
                    alarm::set(LIMIT_S);
                    self.changed = Some(planned);
                    change(planned.change, &self.core, host)?;
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }
}

fn change(change: Change, core: &Handle, host: &mut dyn Host) -> Result<()> {
    match change {
        Change::Register { number, bit } => lock(core).flip = Some((number, 1 << bit)),
        Change::Memory { address, bit } => {
            let held = host.read(address, Width::W8)?;
            host.write(address, Width::W8, held ^ 1 << bit)?;
        }
        Change::Skip { pc } => {
            // The first halfword of a long instruction begins with 0b11101 or above (ARM DDI 0403, A5.1).
            let long = host.read(pc, Width::W16)? >> 11 >= 0b11101;
            lock(core).go_on_at = Some(pc + if long { 4 } else { 2 });
        }
    }
    Ok(())
}

impl Driver<Twin> for Campaign {
    fn on_settled(&mut self, session: &mut Session<Twin>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, value } => self.wait.look(host, access, value),
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
        let is_copy = self.changed.is_some()
            || match self.copy(stop, host) {
                Ok(is_copy) => is_copy,
                Err(error) => {
                    self.broken = Some(error);
                    return None;
                }
            };
        if is_copy {
            let verdict = self.changed.and_then(|changed| (self.judge)(session, stop, &changed));
            if let Some(verdict) = verdict {
                // SAFETY: nothing of a copy needs to be taken down.
                unsafe { libc::_exit(verdict.into()) }
            }
            return Some(VirtualNanos(stop.at.0 + self.step_ns));
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
