//! `majority`: the most frequent class of the training frames, whatever happens.

use anyhow::Result;
use slipsense::params::CLASSES;
use slipsense_recording::Episode;

use super::{Detector, Verdict};

pub(super) struct Majority {
    class: usize,
    /// The more frequent of the two classes without slip.
    fallback: u8,
}

impl Majority {
    /// From the frames of each class; ties go to the lower class.
    pub(super) fn new(class_frames: [u64; CLASSES]) -> Self {
        let fallback = usize::from(class_frames[1] > class_frames[0]);
        let class = if class_frames[2] > class_frames[fallback] { 2 } else { fallback };
        Self { class, fallback: fallback as u8 }
    }
}

impl Detector for Majority {
    fn name(&self) -> &'static str {
        "majority"
    }

    /// Score 1 if slip is the most frequent class, else 0; threshold one half.
    fn judge(&mut self, episode: &Episode) -> Result<Verdict> {
        let frames = episode.frames();
        let score = if self.class == 2 { 1.0 } else { 0.0 };
        Ok(Verdict::new(vec![score; frames], 0.5, vec![self.fallback; frames]))
    }

    fn reset(&mut self) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_most_frequent_class_by_hand() {
        for (frames, class, fallback) in
            [([576, 188, 237], 0, 0), ([188, 576, 237], 1, 1), ([3, 2, 4], 2, 0), ([2, 3, 4], 2, 1)]
        {
            let found = Majority::new(frames);
            assert_eq!((found.class, found.fallback), (class, fallback), "{frames:?}");
        }
    }
}
