//! Step 2: the latest 128 filtered samples of one axis.

use crate::params::XL_WINDOW;

/// The latest samples of one axis, LSB in Q14; zeros before the first.
///
/// The ring is in memory twice, and each sample is written to both: the latest 128 are one slice wherever it begins.
#[derive(Clone, Debug)]
pub struct Ring {
    samples: [[i32; XL_WINDOW]; 2],
    /// Where the next sample goes, which is where the oldest lies; below 128.
    next: usize,
}

impl Ring {
    /// Zeros.
    pub const fn new() -> Self {
        Self { samples: [[0; XL_WINDOW]; 2], next: 0 }
    }

    /// Replace the oldest by a sample, at most [`super::highpass::FILTERED_MAX`] in magnitude.
    #[inline]
    pub fn push(&mut self, sample: i32) {
        let at = self.next % XL_WINDOW;
        for ring in &mut self.samples {
            ring[at] = sample;
        }
        self.next = at + 1;
    }

    /// The samples, oldest first.
    #[inline]
    pub fn latest(&self) -> &[i32; XL_WINDOW] {
        let (_, latest) = self.samples.as_flattened().split_at(self.next % XL_WINDOW);
        // More than 128 lie behind any place in the first ring: there is a chunk.
        latest.first_chunk().unwrap_or(&self.samples[0])
    }
}
