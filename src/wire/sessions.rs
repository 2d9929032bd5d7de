//! Transfers of several senders at once, in fixed memory: one [`Reassembler`] for each recent sender and port, and the
//! clock that a reassembler lacks. A new sender takes the session of the one that was silent longest, first among those
//! with no transfer under way; a transfer lost by this is counted.

use super::cyphal::CanFrame;
use super::id::{NodeId, ServiceRole, TransferId};
use super::receive::{Reassembler, Transfer, TransferError};

/// After this time without a transfer a sender may begin its transfer identifiers anew (OpenCyphal
/// specification 1.0, section 4.1.2.4: 2 s).
pub const TRANSFER_TIMEOUT_US: u64 = 2_000_000;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stream {
    source: NodeId,
    port: u16,
    role: Option<ServiceRole>,
}

#[derive(Clone, Debug)]
struct Session<const CAPACITY: usize> {
    stream: Option<Stream>,
    last_us: u64,
    reassembler: Reassembler<CAPACITY>,
}

/// `N` reassemblers, each for a transfer of at most `CAPACITY` bytes with padding and CRC.
#[derive(Clone, Debug)]
pub struct Sessions<const N: usize, const CAPACITY: usize> {
    sessions: [Session<CAPACITY>; N],
    /// Transfers under way that were given up for a new sender, since start.
    pub displaced: u32,
}

/// Why a frame did not continue or complete a transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SessionError {
    /// The transfer is damaged.
    Transfer(TransferError),
    /// A message without a sender.
    Anonymous,
}

impl<const N: usize, const CAPACITY: usize> Default for Sessions<N, CAPACITY> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize, const CAPACITY: usize> Sessions<N, CAPACITY> {
    /// Before the first frame.
    pub const fn new() -> Self {
        let sessions = [const { Session { stream: None, last_us: 0, reassembler: Reassembler::new() } }; N];
        Self { sessions, displaced: 0 }
    }

    /// Take a frame with identifier `id`; `Some` when it completes a transfer. Every frame takes a session, so the caller
    /// filters by identifier. Messages without a sender are refused.
    pub fn accept<'a>(
        &'a mut self,
        id: TransferId,
        frame: &CanFrame,
        now_us: u64,
    ) -> Result<Option<Transfer<'a>>, SessionError> {
        let stream = match id {
            TransferId::Message(id) => Stream { source: id.node, port: id.port, role: None },
            TransferId::Service(id) => Stream { source: id.source, port: id.port, role: Some(id.role) },
            TransferId::Anonymous(_) => return Err(SessionError::Anonymous),
        };
        let Some(session) = self.session(stream, now_us) else { return Ok(None) };
        if now_us.saturating_sub(session.last_us) > TRANSFER_TIMEOUT_US {
            session.reassembler.reset();
        }
        let arrived = session.reassembler.accept(frame.data()).map_err(SessionError::Transfer)?;
        // A refused frame does not keep a session alive.
        session.last_us = now_us;
        Ok(arrived)
    }

    /// The stream's own session, or another's. `None` only if `N` is 0.
    fn session(&mut self, stream: Stream, now_us: u64) -> Option<&mut Session<CAPACITY>> {
        let own = self.sessions.iter().position(|session| session.stream == Some(stream));
        let index = own.or_else(|| {
            let rank = |session: &Session<CAPACITY>| match session.stream {
                None => (0, 0),
                Some(_) => (1 + u8::from(session.reassembler.is_open()), session.last_us),
            };
            (0..N).min_by_key(|&index| self.sessions.get(index).map(rank))
        })?;
        let session = self.sessions.get_mut(index)?;
        if session.stream != Some(stream) {
            let fresh = now_us.saturating_sub(session.last_us) <= TRANSFER_TIMEOUT_US;
            if session.reassembler.is_open() && fresh {
                self.displaced = self.displaced.saturating_add(1);
            }
            session.stream = Some(stream);
            session.last_us = now_us;
            session.reassembler.reset();
        }
        Some(session)
    }
}
