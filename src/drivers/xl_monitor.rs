//! Keeps one accelerometer running: brings it up step by step at the frame ticks, reads it, restarts it when it fails,
//! and knows which samples are missing.

use super::decimate::Decimator;
use super::sample_count::SampleCount;
use crate::board::{Accelerometer, FIFO_SAMPLES_MAX, FifoSamples, FifoStatus, XlFault};
use crate::params::{FRAME_RATE_HZ, XL_BATCH_MAX};
use crate::sensor::XlSample;

/// Ticks between two attempts at a part that does not answer: 100 ms.
pub const RETRY_TICKS: u32 = FRAME_RATE_HZ / 10;
/// Failed reads in a row after which the part is reset.
pub const FAULTS_TO_RESET: u32 = 3;
/// Ticks without a sample after which the part is taken for dead: it makes 33 in each.
pub const SILENT_TICKS: u32 = 3;

/// What went wrong with one accelerometer since start. Counters saturate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct XlCounters {
    /// Reads that found the FIFO full.
    pub overruns: u32,
    /// Times that the axes were out of step.
    pub resyncs: u32,
    /// Steps and reads that failed.
    pub faults: u32,
    /// Times that the part was started, the first included.
    pub starts: u32,
    /// The last fault.
    pub last_fault: Option<XlFault>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Leave the part alone for this number of ticks.
    Resting(u32),
    /// The reset is over in this number of ticks.
    Resetting(u32),
    /// Its samples are ignored for this number of ticks.
    Settling(u32),
    Running,
}

/// One accelerometer.
#[derive(Debug)]
pub struct XlMonitor<A> {
    part: A,
    phase: Phase,
    count: SampleCount,
    decimator: Option<Decimator>,
    counters: XlCounters,
    /// Failed reads in a row.
    faults: u32,
    /// Ticks in a row without a sample.
    silent_ticks: u32,
    /// Was the FIFO read at the last tick? Then what comes next follows it, unless the FIFO says otherwise.
    was_read: bool,
}

/// What one tick delivers.
pub type XlBatch = heapless::Vec<XlSample, XL_BATCH_MAX>;

impl<A: Accelerometer> XlMonitor<A> {
    /// Before the first tick. The part is reset at the first and delivers some ticks later.
    pub const fn new(part: A) -> Self {
        const {
            assert!(A::PART.decimation == 1 || A::PART.decimation == 2, "there is no other filter");
        }
        Self {
            part,
            phase: Phase::Resting(0),
            count: SampleCount::new(A::PART.native_rate_hz),
            decimator: None,
            counters: XlCounters { overruns: 0, resyncs: 0, faults: 0, starts: 0, last_fault: None },
            faults: 0,
            silent_ticks: 0,
            was_read: false,
        }
    }

    /// What went wrong so far.
    pub const fn counters(&self) -> XlCounters {
        self.counters
    }

    /// The count of the part's samples, at its native rate.
    pub const fn count(&self) -> &SampleCount {
        &self.count
    }

    /// Index of the sample after the last one delivered, counted since the first tick, wraps.
    pub const fn xl_end(&self) -> u32 {
        (self.count.total() / A::PART.decimation as u64) as u32
    }

    /// One frame tick at `now_us`: a few transfers, then `xl` holds what arrived. `false`: nothing did.
    pub async fn tick(&mut self, now_us: u64, fifo: &mut FifoSamples, xl: &mut XlBatch) -> bool {
        xl.clear();
        let running = self.phase == Phase::Running;
        match self.step(fifo).await {
            Ok(status) if running => self.take(now_us, fifo, status, xl),
            Ok(_) => self.miss(now_us),
            Err(fault) => {
                self.fail(fault);
                self.miss(now_us)
            }
        }
    }

    /// One step of the way from a dead part to its samples.
    async fn step(&mut self, fifo: &mut FifoSamples) -> Result<FifoStatus, XlFault> {
        match self.phase {
            Phase::Resting(0) => {
                self.part.reset().await?;
                self.phase = Phase::Resetting(A::PART.reset_ticks);
            }
            Phase::Resting(ticks) => self.phase = Phase::Resting(ticks - 1),
            Phase::Resetting(0 | 1) => {
                self.part.configure().await?;
                self.counters.starts = self.counters.starts.saturating_add(1);
                self.phase = Phase::Settling(A::PART.settling_ticks);
            }
            Phase::Resetting(ticks) => self.phase = Phase::Resetting(ticks - 1),
            Phase::Settling(ticks) => {
                self.part.drain(fifo).await?;
                (self.faults, self.silent_ticks) = (0, 0);
                self.phase = if ticks <= 1 { Phase::Running } else { Phase::Settling(ticks - 1) };
            }
            Phase::Running => {
                let status = self.part.drain(fifo).await?;
                self.silent_ticks = if fifo.is_empty() { self.silent_ticks + 1 } else { 0 };
                if self.silent_ticks >= SILENT_TICKS {
                    return Err(XlFault::Silent);
                }
                self.faults = 0;
                self.counters.overruns = self.counters.overruns.saturating_add(status.overrun.into());
                self.counters.resyncs = self.counters.resyncs.saturating_add(status.resyncs);
                return Ok(status);
            }
        }
        Ok(FifoStatus::default())
    }

    /// What was read goes to the frame. Where it does not follow what was read before, or not all of it fits, the index
    /// of its end says so.
    fn take(&mut self, now_us: u64, samples: &FifoSamples, fifo: FifoStatus, xl: &mut XlBatch) -> bool {
        // A part makes 33 samples between two ticks: one without any has stopped, though it answers.
        if samples.is_empty() {
            return self.miss(now_us);
        }
        let native = samples.len() as u32;
        if self.was_read && fifo.is_continuous() {
            self.count.read(now_us, native);
        } else {
            // Enough that a sample is missing also after decimation.
            let lost = if fifo.is_continuous() { 0 } else { A::PART.decimation };
            self.count.resume(now_us, native, lost);
            self.decimator = None;
        }
        self.was_read = true;
        if A::PART.decimation == 1 {
            // Of more samples than a batch holds the newest.
            let from = samples.len().saturating_sub(XL_BATCH_MAX);
            _ = xl.extend_from_slice(samples.get(from..).unwrap_or_default());
        } else {
            // The index of each sample decides which half of them is kept, so the count stays true over gaps.
            let first = self.count.total() - u64::from(native);
            for (index, &sample) in (first..).zip(samples) {
                let decimator = self.decimator.get_or_insert_with(|| Decimator::primed(sample));
                // There is room: half of what the FIFO of such a part holds, asserted below.
                if let Some(sample) = decimator.push(sample, index % 2 == 1) {
                    _ = xl.push(sample);
                }
            }
        }
        true
    }

    fn miss(&mut self, now_us: u64) -> bool {
        self.count.missed(now_us);
        (self.was_read, self.decimator) = (false, None);
        false
    }

    fn fail(&mut self, fault: XlFault) {
        self.counters.faults = self.counters.faults.saturating_add(1);
        self.counters.last_fault = Some(fault);
        self.faults += 1;
        let reading = matches!(self.phase, Phase::Settling(_) | Phase::Running);
        if !reading || fault == XlFault::Silent || self.faults >= FAULTS_TO_RESET {
            (self.faults, self.silent_ticks) = (0, 0);
            self.phase = Phase::Resting(if reading { 0 } else { RETRY_TICKS });
        }
    }
}

const _: () = assert!(FIFO_SAMPLES_MAX >= XL_BATCH_MAX && FIFO_SAMPLES_MAX / 2 <= XL_BATCH_MAX);
