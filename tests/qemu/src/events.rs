//! What goes into the real-time run and what it reports: a file of numbers in, two files of events out, one of the bus
//! and one of the frames, and the node's status at the end.

use bytemuck::{Pod, Zeroable};
use slipsense::board::TxSlot;
use slipsense::health::Status;
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

pub const DISTURBANCE_BYTES: usize = 6 * 8;

pub fn encode_disturbance(disturbance: &Disturbance) -> [u8; DISTURBANCE_BYTES] {
    let Disturbance { foreign_load_percent, error_every, silent_ns, dominant_ns } = disturbance;
    let [silent, dominant] = [silent_ns, dominant_ns].map(|range| [range.start, range.end]);
    bytemuck::must_cast([[*foreign_load_percent, (*error_every).into()], silent, dominant])
}

pub fn decode_disturbance(bytes: [u8; DISTURBANCE_BYTES]) -> Disturbance {
    let [foreign_load_percent, error_every, a, b, c, d]: [u64; 6] = bytemuck::pod_read_unaligned(&bytes);
    Disturbance { foreign_load_percent, error_every: error_every as u32, silent_ns: a..b, dominant_ns: c..d }
}

pub const EVENT_BYTES_MAX: usize = 8 + 8 + 1 + 4 + 1 + 64;

/// Write a frame that arrived through `put`.
pub fn encode_arrived(arrived: &Arrived, mut put: impl FnMut(&[u8])) {
    put(bytemuck::bytes_of(&[arrived.at_ns, arrived.handed_over_ns]));
    put(&[arrived.slot as u8]);
    put(&arrived.frame.id().to_le_bytes());
    put(&[arrived.frame.data().len() as u8]);
    put(arrived.frame.data());
}

/// Take one off the front of `bytes`; `None` if they end inside it or are none.
pub fn decode_arrived(bytes: &mut &[u8]) -> Option<Arrived> {
    let mut reader = Reader(bytes);
    let [at_ns, handed_over_ns] = reader.next()?;
    let slot = *TxSlot::ALL.get(usize::from(reader.next::<u8>()?))?;
    let (id, length): (u32, u8) = (reader.next()?, reader.next()?);
    let frame = CanFrame::new(id, reader.take(length.into())?).ok()?;
    *bytes = reader.0;
    Some(Arrived { at_ns, handed_over_ns, slot, frame })
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Decided {
    pub sequence: u32,
    /// Time from its tick to the slip message in the queue, µs.
    pub queued_us: u32,
    /// Time from its tick until inference was through with it, raw messages included, µs.
    pub done_us: u32,
}

pub fn decode_decided(bytes: &[u8]) -> impl Iterator<Item = Decided> {
    bytes.chunks_exact(size_of::<Decided>()).map(bytemuck::pod_read_unaligned)
}

/// The counters of a [`Status`] that the run reports, as in the file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct Counters {
    pub dropped_frames: u32,
    pub late_frames: u32,
    pub replaced_slips: u32,
    pub dropped_raw: u32,
    pub broken_raw: u32,
    pub bus_offs: u32,
    pub bus_off_us: u32,
    pub waiting_raw: u32,
}

impl Counters {
    /// From the file; `None` if it is none.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        bytemuck::try_pod_read_unaligned(bytes).ok()
    }

    pub fn new(status: &Status, waiting_raw: usize) -> Self {
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
}
