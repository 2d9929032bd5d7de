//! What a run is told of the board.

use std::sync::Arc;

use slipsense_recording::Episode;

use crate::bench::Desk;
use crate::fault_injection::Faults;
use crate::xl::Xl;

/// What is fitted to the board, and what happens to it.
#[derive(Debug, Default)]
pub struct Fitted {
    /// What the sensors play; none: no accelerometer, and arrays that nothing touches.
    pub episode: Option<Arc<Episode>>,
    /// Sensors at rest, in place of an episode.
    pub desk: Option<Desk>,
    pub xl: Xl,
    pub faults: Faults,
    /// Every event of the scan one by one, and every access through the MPU.
    pub slow: bool,
    /// What comes in at HSE, Hz; 0: nothing.
    pub hse_hz: u64,
}
