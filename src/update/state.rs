//! What embassy-boot's state says of the firmware that runs, and when a new one has shown that it works.

use embassy_boot::{FirmwareState, State};
use embedded_storage_async::nor_flash::NorFlash;

use super::Refusal;
use super::slot::WORD;
use crate::params::FRAME_RATE_HZ;

/// Frames that a new firmware decides before it confirms: ten seconds.
pub const CONFIRM_FRAMES: u32 = 10 * FRAME_RATE_HZ;
/// Heartbeats that it has brought onto the bus by then, at least: as many seconds, less a few for its address.
pub const CONFIRM_HEARTBEATS: u32 = 5;

/// How the firmware that runs came to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Run {
    /// It has confirmed, or was never on trial.
    Confirmed,
    /// The same, and a new one is ready to be swapped in at the next restart.
    Pending,
    /// It is new: the next restart swaps the one before in again, unless it has confirmed by then.
    OnTrial,
    /// The one after it did not confirm.
    RolledBack,
}

/// embassy-boot's state, in a sector of its own. The one error is [`Refusal::Flash`].
pub struct UpdateState<S>(S);

impl<S: NorFlash> UpdateState<S> {
    /// `flash` holds the state from its address 0 on, and nothing else.
    pub const fn new(flash: S) -> Self {
        Self(flash)
    }

    /// How the firmware came to run.
    pub async fn run(&mut self) -> Result<Run, Refusal> {
        let mut word = [0; WORD];
        let state = self.state(&mut word)?.get_state().await.map_err(|_| Refusal::Flash)?;
        Ok(match state {
            State::Boot | State::DfuDetach => Run::Confirmed,
            State::Revert => Run::RolledBack,
            // embassy-boot's layout: magic, validity of the progress, progress; one word each, blank at first. An
            // invalid progress is the first thing that confirming writes: it was cut off there.
            State::Swap if !self.is_blank(1).await? => Run::Confirmed,
            State::Swap if self.is_blank(2).await? => Run::Pending,
            State::Swap => Run::OnTrial,
        })
    }

    async fn is_blank(&mut self, index: u32) -> Result<bool, Refusal> {
        let mut word = [0; WORD];
        let word = word.get_mut(..S::WRITE_SIZE).ok_or(Refusal::Flash)?;
        self.0.read(index * S::WRITE_SIZE as u32, word).await.map_err(|_| Refusal::Flash)?;
        Ok(word.iter().all(|&byte| byte == 0xFF))
    }

    /// To read or to write it, by way of a word.
    fn state<'w>(&'w mut self, word: &'w mut [u8; WORD]) -> Result<FirmwareState<'w, &'w mut S>, Refusal> {
        let word = word.get_mut(..S::WRITE_SIZE).ok_or(Refusal::Flash)?;
        Ok(FirmwareState::new(&mut self.0, word))
    }

    /// The firmware that runs stays: no rollback. Also withdraws a firmware that is [`Run::Pending`], and forgets that
    /// one was rolled back. Nothing is written if that is so already.
    pub async fn confirm(&mut self) -> Result<(), Refusal> {
        let mut word = [0; WORD];
        let mut state = self.state(&mut word)?;
        if state.get_state().await.map_err(|_| Refusal::Flash)? == State::Boot {
            return Ok(());
        }
        state.mark_booted().await.map_err(|_| Refusal::Flash)
    }

    /// Swap at the next restart. Only for what has been checked where it lies.
    pub(super) async fn mark_updated(&mut self) -> Result<(), Refusal> {
        self.state(&mut [0; WORD])?.mark_updated().await.map_err(|_| Refusal::Flash)
    }
}

/// What a firmware has shown since it started.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Evidence {
    /// Frames decided.
    pub frames: u32,
    /// Heartbeats that have left for the bus.
    pub heartbeats: u32,
    /// Requests of other nodes answered: it receives.
    pub requests: u32,
    /// Does a sensor in use deliver now, and has no check of the node by itself failed?
    pub senses: bool,
}

/// A new firmware showing that it works: [`CONFIRM_FRAMES`] decided, [`CONFIRM_HEARTBEATS`] on the bus, a request
/// answered, a sensor that delivers. Whatever keeps it from that, the watchdog among it, ends in a restart and the
/// rollback: one that hears nothing could not be updated again.
#[derive(Clone, Debug)]
pub struct Trial {
    open: bool,
}

impl Trial {
    /// As [`UpdateState::run`] says.
    pub const fn new(run: Run) -> Self {
        Self { open: matches!(run, Run::OnTrial) }
    }

    /// `true` once: it has shown that it works, [`UpdateState::confirm`] now.
    pub fn observe(&mut self, evidence: Evidence) -> bool {
        let Evidence { frames, heartbeats, requests, senses } = evidence;
        let works = frames >= CONFIRM_FRAMES && heartbeats >= CONFIRM_HEARTBEATS && requests > 0 && senses;
        let shown = self.open && works;
        self.open &= !shown;
        shown
    }
}
