//! What the real-time run is told and what it reports: a file of numbers in, two files of events out, one of the bus
//! and one of the frames, and the node's status at the end.

use slipsense::board::Lane;
use slipsense::tasks::Status;
use slipsense::wire::CanFrame;
use slipsense_can_sim::controller::{Arrived, Disturbance};

use crate::bytes::Reader;

/// Name of the file with the [`Disturbance`].
pub const BUS_FILE: &str = "bus.in";
/// Name of the file with what arrived on the bus.
pub const ARRIVED_FILE: &str = "bus.out";
/// Name of the file with what became of each frame.
pub const DECIDED_FILE: &str = "frames.out";
/// Name of the file with the status at the end.
pub const STATUS_FILE: &str = "status.out";

/// Time of the tick before the first, µs of the emulated clock: the start-up is over by then.
pub const START_US: u64 = 100_000;
/// Emulated instructions per microsecond: one per cycle of a core at 480 MHz.
pub const INSTRUCTIONS_PER_US: u64 = 480;

/// Bytes of a [`Disturbance`].
pub const DISTURBANCE_BYTES: usize = 6 * 8;

/// As written to the file.
pub fn encode_disturbance(disturbance: &Disturbance) -> [u8; DISTURBANCE_BYTES] {
    let numbers = [
        disturbance.foreign_load_percent,
        disturbance.error_every.into(),
        disturbance.silent_ns.start,
        disturbance.silent_ns.end,
        disturbance.dominant_ns.start,
        disturbance.dominant_ns.end,
    ];
    let mut out = [0; DISTURBANCE_BYTES];
    out.iter_mut().zip(numbers.into_iter().flat_map(u64::to_le_bytes)).for_each(|(out, byte)| *out = byte);
    out
}

/// `None` if these bytes are none.
pub fn decode_disturbance(bytes: &[u8; DISTURBANCE_BYTES]) -> Option<Disturbance> {
    let mut reader = Reader(bytes);
    Some(Disturbance {
        foreign_load_percent: reader.u64()?,
        error_every: u32::try_from(reader.u64()?).ok()?,
        silent_ns: reader.u64()?..reader.u64()?,
        dominant_ns: reader.u64()?..reader.u64()?,
    })
}

/// Bytes of the longest event.
pub const EVENT_BYTES_MAX: usize = 8 + 8 + 1 + 4 + 1 + 64;

/// Write a frame that arrived through `put`.
pub fn encode_arrived(arrived: &Arrived, mut put: impl FnMut(&[u8])) {
    put(&arrived.at_ns.to_le_bytes());
    put(&arrived.handed_over_ns.to_le_bytes());
    put(&[arrived.lane as u8]);
    put(&arrived.frame.id().to_le_bytes());
    put(&[arrived.frame.data().len() as u8]);
    put(arrived.frame.data());
}

/// Take one off the front of `bytes`; `None` if they end inside it or are none.
pub fn decode_arrived(bytes: &mut &[u8]) -> Option<Arrived> {
    let mut reader = Reader(bytes);
    let (at_ns, handed_over_ns) = (reader.u64()?, reader.u64()?);
    let lane = *Lane::ALL.get(usize::from(reader.u8()?))?;
    let (id, length) = (reader.u32()?, reader.u8()?);
    let frame = CanFrame::new(id, reader.take(length.into())?).ok()?;
    *bytes = reader.0;
    Some(Arrived { at_ns, handed_over_ns, lane, frame })
}

/// A frame that was decided.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Decided {
    /// Number of the frame.
    pub sequence: u32,
    /// Time from its tick to the slip message in the queue, µs.
    pub queued_us: u32,
    /// Time from its tick until inference was through with it, raw messages included, µs.
    pub done_us: u32,
}

/// Bytes of a [`Decided`].
pub const DECIDED_BYTES: usize = 3 * 4;

impl Decided {
    /// As written to the file.
    pub fn encode(&self) -> [u8; DECIDED_BYTES] {
        let mut out = [0; DECIDED_BYTES];
        let bytes = [self.sequence, self.queued_us, self.done_us].into_iter().flat_map(u32::to_le_bytes);
        out.iter_mut().zip(bytes).for_each(|(out, byte)| *out = byte);
        out
    }

    /// `None` if these bytes are none.
    pub fn decode(bytes: &[u8; DECIDED_BYTES]) -> Option<Self> {
        let mut reader = Reader(bytes);
        Some(Self { sequence: reader.u32()?, queued_us: reader.u32()?, done_us: reader.u32()? })
    }
}

/// The counters of a [`Status`] that the run reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// As in [`Status`].
    pub dropped_frames: u32,
    /// As in [`Status`].
    pub late_frames: u32,
    /// As in [`Status`].
    pub replaced_slips: u32,
    /// As in [`Status`].
    pub dropped_raw: u32,
    /// As in [`Status`].
    pub broken_raw: u32,
    /// As in [`Status`].
    pub bus_offs: u32,
    /// As in [`Status`].
    pub bus_off_us: u32,
    /// Raw messages that still waited for the bus.
    pub waiting_raw: u32,
}

/// Bytes of [`Counters`].
pub const COUNTERS_BYTES: usize = 8 * 4;

impl Counters {
    /// Those of a node.
    pub fn of(status: &Status, waiting_raw: usize) -> Self {
        Self {
            dropped_frames: status.dropped_frames,
            late_frames: status.late_frames,
            replaced_slips: status.replaced_slips,
            dropped_raw: status.dropped_raw,
            broken_raw: status.broken_raw,
            bus_offs: status.bus_offs,
            bus_off_us: status.bus_off_us,
            waiting_raw: waiting_raw as u32,
        }
    }

    /// As written to the file.
    pub fn encode(&self) -> [u8; COUNTERS_BYTES] {
        let numbers = [
            self.dropped_frames,
            self.late_frames,
            self.replaced_slips,
            self.dropped_raw,
            self.broken_raw,
            self.bus_offs,
            self.bus_off_us,
            self.waiting_raw,
        ];
        let mut out = [0; COUNTERS_BYTES];
        out.iter_mut()
            .zip(numbers.into_iter().flat_map(u32::to_le_bytes))
            .for_each(|(out, byte)| *out = byte);
        out
    }

    /// `None` if these bytes are none.
    pub fn decode(bytes: &[u8; COUNTERS_BYTES]) -> Option<Self> {
        let mut reader = Reader(bytes);
        Some(Self {
            dropped_frames: reader.u32()?,
            late_frames: reader.u32()?,
            replaced_slips: reader.u32()?,
            dropped_raw: reader.u32()?,
            broken_raw: reader.u32()?,
            bus_offs: reader.u32()?,
            bus_off_us: reader.u32()?,
            waiting_raw: reader.u32()?,
        })
    }
}
