//! `always-slip`: slip whenever something is held. It misses nothing and is never late, which shows what
//! latency is worth without false alarms beside it.

use anyhow::Result;
use slipsense_recording::Episode;

use super::{Detector, Verdict, touched};

pub(super) struct AlwaysSlip;

impl Detector for AlwaysSlip {
    fn name(&self) -> &'static str {
        "always-slip"
    }

    /// Score 1 in contact, else 0; threshold one half.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let touched: Vec<bool> = (0..episode.frames()).map(|frame| touched(episode, frame)).collect();
        let score = touched.iter().map(|&t| f32::from(u8::from(t))).collect();
        Ok(Verdict::new(score, 0.5, touched.into_iter().map(u8::from).collect()))
    }

    fn reset(&mut self) {}
}
