//! The emulated board in real time: sensors that tick, a bus that takes its time, and logs of both.

use embassy_time::{Instant, Timer};
use heapless::Vec;
use slipsense::board::replay::{FRAME_BYTES_MAX, frame_bytes};
use slipsense::board::{CanTransmit, Clock, FrameSource, Observe, TxSlot};
use slipsense::health::CanStatus;
use slipsense::params::{FRAME_RATE_HZ, MAX_SENSORS, TAXELS, XL_AXES, XL_BATCH_MAX};
use slipsense::pipeline::FrameStamp;
use slipsense::sensor::PiezoFrame;
use slipsense::sensor::SensorReadings;
use slipsense::wire::CanFrame;
use slipsense_can_sim::controller::{Arrived, Bus};
use slipsense_qemu::emulated::semihosting::File;
use slipsense_qemu::events::{Decided, EVENT_BYTES_MAX, START_US, encode_arrived};
use slipsense_qemu::input::Header;

#[derive(Clone, Copy)]
pub struct Uptime;

impl Clock for Uptime {
    fn now_us(&self) -> u64 {
        Instant::now().as_micros()
    }
}

/// One frame record of the input file, where words lie on word boundaries.
#[repr(C, align(4))]
pub struct FrameBuffer(pub [u8; FRAME_BYTES_MAX]);

pub struct Sensors {
    pub file: File,
    pub header: Header,
    pub read: u32,
    pub record: FrameBuffer,
}

const MICROS_PER_SECOND: u64 = 1_000_000;
const STAMP_BYTES: usize = 12;
const PART_BYTES: usize = frame_bytes(2) - frame_bytes(1);

impl FrameSource for Sensors {
    const REAL_TIME: bool = true;

    async fn tick(&mut self) -> Option<FrameStamp> {
        if self.read == self.header.frames {
            return None;
        }
        self.read += 1;
        let since_start_us = u64::from(self.read) * MICROS_PER_SECOND / u64::from(FRAME_RATE_HZ);
        let timestamp_us = START_US + since_start_us;
        Timer::at(Instant::from_micros(timestamp_us)).await;
        let record = self.record.0.get_mut(..frame_bytes(self.header.sensors as usize));
        // What DMA does on a board: it takes the core no time.
        self.file.read_exact(record.expect("the header was checked")).expect("a whole frame");
        Some(FrameStamp { sequence: self.read - 1, timestamp_us })
    }

    /// What a driver does with what DMA has left: copies, and the rules for a scan.
    async fn read(&mut self, parts: &mut [SensorReadings; MAX_SENSORS]) {
        let records = self.record.0[STAMP_BYTES..].chunks_exact(PART_BYTES);
        for (part, record) in parts.iter_mut().zip(records).take(self.header.sensors as usize) {
            let (head, data) = record.split_at(8);
            let (counts, samples) = data.split_at(2 * TAXELS);
            let arrived = u16::from_le_bytes([head[0], head[1]]);
            let length = usize::from(u16::from_le_bytes([head[2], head[3]]));
            (part.piezo_arrived, part.xl_arrived) = (arrived & 1 != 0, arrived & 2 != 0);
            part.xl_end = u32::from_le_bytes([head[4], head[5], head[6], head[7]]);
            let counts: &[u16] = bytemuck::cast_slice(counts);
            part.piezo = PiezoFrame::from_scan(counts.try_into().expect("a scan"));
            let samples: &[[i16; XL_AXES]] = bytemuck::cast_slice(samples);
            part.xl.clear();
            part.xl.extend_from_slice(&samples[..length.min(XL_BATCH_MAX)]).expect("there is room");
        }
    }
}

/// Bytes that are written to a file when there are many.
pub struct Log {
    file: File,
    bytes: Vec<u8, 16384>,
}

impl Log {
    pub const fn new(file: File) -> Self {
        Self { file, bytes: Vec::new() }
    }

    fn put(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes).expect("flushed in time");
    }

    fn flush_if_full(&mut self) {
        if self.bytes.capacity() - self.bytes.len() < EVENT_BYTES_MAX {
            self.flush();
        }
    }

    pub fn flush(&mut self) {
        self.file.write_all(&self.bytes);
        self.bytes.clear();
    }
}

pub struct Hardware {
    pub bus: Bus,
    pub log: Log,
    /// When the bus was looked at last. What is done after it takes no time until the next look: reading the clock
    /// costs the emulator more than the core.
    pub looked_ns: u64,
    pub seen: ([bool; TxSlot::ALL.len()], CanStatus),
}

impl Hardware {
    fn look(&mut self) -> ([bool; TxSlot::ALL.len()], CanStatus) {
        let log = &mut self.log;
        self.looked_ns = Instant::now().as_micros() * 1000;
        self.bus.advance(self.looked_ns, |arrived: Arrived| {
            encode_arrived(&arrived, |bytes| log.put(bytes));
            log.flush_if_full();
        });
        (TxSlot::ALL.map(|slot| self.bus.is_free(slot)), self.bus.status())
    }
}

impl CanTransmit for Hardware {
    fn is_free(&self, slot: TxSlot) -> bool {
        self.bus.is_free(slot)
    }

    fn transmit(&mut self, slot: TxSlot, frame: &CanFrame) {
        self.bus.put(slot, frame, self.looked_ns);
        self.seen.0[slot as usize] = false;
    }

    fn withdraw(&mut self, slot: TxSlot) {
        self.bus.withdraw(slot);
        self.seen.0[slot as usize] = self.bus.is_free(slot);
    }

    fn has_sent(&self, slot: TxSlot) -> bool {
        self.bus.has_sent(slot)
    }

    async fn changed(&mut self) {
        loop {
            let now = self.look();
            if now != self.seen {
                self.seen = now;
                return;
            }
            match self.bus.next_event_ns() {
                Some(ns) => Timer::at(Instant::from_micros(ns.div_ceil(1000))).await,
                None => core::future::pending().await,
            }
        }
    }

    fn status(&mut self) -> CanStatus {
        self.seen = self.look();
        self.seen.1
    }
}

/// Writes down when what was done.
pub struct Frames {
    pub log: Log,
    pub queued_us: u32,
}

fn age_us(stamp: FrameStamp) -> u32 {
    (Instant::now().as_micros() - stamp.timestamp_us) as u32
}

impl Observe for Frames {
    fn slip_queued(&mut self, stamp: FrameStamp) {
        self.queued_us = age_us(stamp);
    }

    fn frame_done(&mut self, stamp: FrameStamp) {
        let decided = Decided { sequence: stamp.sequence, queued_us: self.queued_us, done_us: age_us(stamp) };
        self.log.put(bytemuck::bytes_of(&decided));
        self.log.flush_if_full();
    }
}
