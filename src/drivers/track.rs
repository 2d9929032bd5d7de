//! Keeps one accelerometer running: brings it up step by step at the frame ticks, reads it, restarts it when it fails,
//! and knows which samples are missing.

use super::decimate::Decimator;
use super::sample_count::SampleCount;
use crate::board::{Accelerometer, Drained, FIFO_SAMPLES_MAX, FifoSamples, XlFault};
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
    /// Leave the part alone for so many ticks.
    Resting(u32),
    /// The reset is over in so many ticks.
    Resetting(u32),
    /// Its samples count for nothing for so many ticks.
    Settling(u32),
    Running,
}

/// One accelerometer.
#[derive(Debug)]
pub struct XlTrack<A> {
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
    /// Did the last tick deliver? Then what is delivered next will be joined to it.
    heard: bool,
    /// Nobody took what the last tick delivered: what is delivered next would be joined to something older.
    discarded: bool,
}

/// What one tick delivers.
pub type XlBatch = heapless::Vec<XlSample, XL_BATCH_MAX>;

impl<A: Accelerometer> XlTrack<A> {
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
            heard: false,
            discarded: false,
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

    /// The part itself.
    pub const fn part(&mut self) -> &mut A {
        &mut self.part
    }

    /// Index of the sample after the last one delivered, counted since the first tick, wraps.
    pub const fn xl_end(&self) -> u32 {
        (self.count.total() / A::PART.decimation as u64) as u32
    }

    /// One frame tick at `now_us`: a few transfers, then `xl` holds what arrived. `false`: nothing did, or what did
    /// must not be joined to the samples of the tick before.
    pub async fn tick(&mut self, now_us: u64, fifo: &mut FifoSamples, xl: &mut XlBatch) -> bool {
        xl.clear();
        let running = self.phase == Phase::Running;
        match self.step(fifo).await {
            Ok(drained) if running => self.take(now_us, fifo, drained, xl),
            Ok(_) => self.miss(now_us),
            Err(fault) => {
                self.fail(fault);
                self.miss(now_us)
            }
        }
    }

    /// Nobody takes what the last [`tick`](Self::tick) read: the next one leaves a gap in its place.
    pub const fn discard(&mut self) {
        self.discarded = true;
    }

    /// One step of the way from a dead part to its samples.
    async fn step(&mut self, fifo: &mut FifoSamples) -> Result<Drained, XlFault> {
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
                let drained = self.part.drain(fifo).await?;
                self.silent_ticks = if fifo.is_empty() { self.silent_ticks + 1 } else { 0 };
                if self.silent_ticks >= SILENT_TICKS {
                    return Err(XlFault::Silent);
                }
                self.faults = 0;
                self.counters.overruns = self.counters.overruns.saturating_add(drained.overrun.into());
                self.counters.resyncs = self.counters.resyncs.saturating_add(drained.resyncs);
                return Ok(drained);
            }
        }
        Ok(Drained::default())
    }

    /// What was read goes to the frame, unless it would be joined to samples that it does not follow: the front end
    /// would hear the jump as a knock. It forgets them when one frame is missing, and that frame is this one.
    fn take(&mut self, now_us: u64, fifo: &FifoSamples, drained: Drained, xl: &mut XlBatch) -> bool {
        // A part makes 33 samples between two ticks: one without any has stopped, though it answers.
        if fifo.is_empty() {
            return self.miss(now_us);
        }
        let native = fifo.len() as u32;
        let follows = self.was_read && drained.is_whole();
        if follows {
            self.count.read(now_us, native);
        } else {
            self.count.resume(now_us, native);
        }
        self.was_read = true;
        let fits = fifo.len().div_ceil(A::PART.decimation as usize) <= XL_BATCH_MAX;
        let broken = drained.resyncs > 0 || !fits;
        if broken || self.discarded || self.heard && !follows {
            (self.heard, self.discarded, self.decimator) = (false, false, None);
            return false;
        }
        if A::PART.decimation == 1 {
            // There is room: asked above.
            _ = xl.extend_from_slice(fifo);
        } else {
            // The index of each sample decides which half of them is kept, so the count stays true over gaps.
            let first = self.count.total() - u64::from(native);
            for (index, &sample) in (first..).zip(fifo) {
                let decimator = self.decimator.get_or_insert_with(|| Decimator::primed(sample));
                // There is room: half of what the FIFO holds.
                if let Some(sample) = decimator.push(sample, index % 2 == 1) {
                    _ = xl.push(sample);
                }
            }
        }
        self.heard = true;
        true
    }

    fn miss(&mut self, now_us: u64) -> bool {
        self.count.missed(now_us);
        (self.was_read, self.heard, self.discarded, self.decimator) = (false, false, false, None);
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

const _: () = assert!(FIFO_SAMPLES_MAX >= XL_BATCH_MAX);
