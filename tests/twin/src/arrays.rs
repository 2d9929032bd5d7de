//! The taxel arrays: an address on ten pins becomes a voltage at the ADC's inputs, and a timer's trigger starts the
//! ADC, which the emulator's model does not do.
//!
//! ```text
//! TIM8 TRGO ──> write to ADC1 that the bus carries ──> conversion (emulator's model, one sequence)
//! GPIOE ODR ──> address ──> settling ──> input at the end of sampling
//! ```

use std::sync::{Arc, Mutex};

use slipsense::params::TAXELS;
use slipsense::transfer::adc_code;

use crate::bench::{self, DeskFault};
use crate::fault_injection::Kind;
use crate::fitted::Fitted;
use crate::scan_timing::{DEAD_NS, FastScan, SETTLED_NS};

/// The emulator's ADC takes whole millivolts, coarser than a code: its reference is 65,535 V here, a code a volt, and
/// half a volt more so that rounding cannot lose one.
pub const REFERENCE_MV: u32 = 65_535_000;
const TAU_NS: f64 = 154.0;

#[derive(Debug, Default)]
pub struct Arrays {
    fitted: Arc<Fitted>,
    /// Address now and before, and since when.
    address: usize,
    before: usize,
    since_ns: u64,
    /// Frame of the episode that is scanned, and was at the address before.
    frame: usize,
    frame_before: usize,
    pub triggered: bool,
    /// The scan that needs no event per slot.
    pub fast_scan: FastScan,
}

pub type Shared = Arc<Mutex<Arrays>>;

impl Arrays {
    /// Arrays under the pressure of the episode; none without an episode.
    pub fn new(fitted: &Arc<Fitted>) -> Shared {
        let fast_scan = FastScan { enabled: !fitted.slow, ..FastScan::default() };
        Arc::new(Mutex::new(Self { fitted: fitted.clone(), fast_scan, ..Self::default() }))
    }

    /// What the driver makes the episode's count of.
    fn settled(&self, frame: usize, address: usize, sensor: usize) -> f64 {
        if let Some(desk) = self.fitted.desk {
            return desk.code(frame, address, sensor).into();
        }
        let episode = self.fitted.episode.as_ref().filter(|episode| sensor < episode.sensors);
        // Over and over.
        let count =
            episode.map_or(0, |episode| episode.piezo(frame % episode.frames(), sensor).counts()[address]);
        // Without noise an untouched array would be a dead one; below idle a code's count is 0 all the same.
        let noise = if count == 0 { (frame * 5 + address * 11) % 8 } else { 0 };
        f64::from(adc_code(count) - noise as u16)
    }

    /// Levels of the port's pins, as its register is read.
    pub fn pins(&self, levels: u64, moder: u64) -> u64 {
        self.fitted.desk.map_or(levels, |desk| desk.pins(levels, moder))
    }

    /// The last taxel's address gives way to the first's: the next frame of the episode.
    pub fn addressed(&mut self, address: usize, now_ns: u64) {
        if address == self.address {
            return;
        }
        (self.before, self.frame_before) = (self.address, self.frame);
        if self.address == TAXELS - 1 && address == 0 {
            self.frame += 1;
        }
        (self.address, self.since_ns) = (address, now_ns);
    }

    pub fn code(&self, sensor: usize, at_ns: u64) -> u32 {
        if self.fitted.faults.active(at_ns).any(|kind| kind == Kind::AdcStuck) {
            return 1234;
        }
        let old = self.settled(self.frame_before, self.before, sensor);
        if at_ns < self.since_ns + DEAD_NS {
            return old as u32;
        }
        let new = self.settled(self.frame, self.address, sensor);
        let slow = sensor == 0 && bench::has(self.fitted.desk, DeskFault::Slow);
        if at_ns > self.since_ns + DEAD_NS + SETTLED_NS && !slow {
            return new as u32;
        }
        let tau_ns = if slow { bench::SLOW_TAU_NS } else { TAU_NS };
        let left = (-((at_ns - self.since_ns - DEAD_NS) as f64) / tau_ns).exp();
        (new + (old - new) * left).round() as u32
    }
}
