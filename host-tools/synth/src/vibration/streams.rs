//! Which stream each source of vibration streams from.
//!
//! A recording is made whole: its sources draw one after the other from one stream. A plant whose future is
//! not known yet is made again whenever a command changes it; there every source has a stream of its own,
//! which it streams from in the order of time, so that what is past comes out the same.

use crate::draw::Rng;

#[derive(Clone, Copy, Debug)]
pub(crate) enum NoiseSource {
    Rubbing = 1,
    StickSlip,
    Creak,
    MicroSlip,
    RailBursts,
    Rail,
    Drag,
    DragPulses,
    Autoregressive,
    Aftershocks,
    Nearby,
    Grains,
    Elsewhere,
}

pub(crate) struct NoiseStreams {
    rng: Rng,
    /// Stream of the finger, where every source has one of its own.
    apart: Option<u64>,
}

/// Streams of the sources lie above those of [`crate::draw::Stream`].
const SOURCE_SHIFT: u32 = 32;

impl NoiseStreams {
    pub(crate) fn in_turn(rng: Rng) -> Self {
        Self { rng, apart: None }
    }

    pub(crate) fn apart(rng: Rng) -> Self {
        let stream = rng.get_stream();
        Self { rng, apart: Some(stream) }
    }

    /// What a source streams from, once per recording.
    pub(crate) fn of(&mut self, source: NoiseSource) -> &mut Rng {
        if let Some(finger) = self.apart {
            self.rng.set_stream(finger | (source as u64) << SOURCE_SHIFT);
            self.rng.set_word_pos(0);
        }
        &mut self.rng
    }
}
