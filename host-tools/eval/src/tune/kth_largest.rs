//! The k-of-n rule as a score.

use std::collections::VecDeque;

/// The `k`-th largest of the last `n` margins: at least `k` of them are over a threshold exactly where this
/// one is, so that a threshold can be swept over it.
#[derive(Clone, Debug)]
pub struct KthLargest {
    k: usize,
    n: usize,
    recent: VecDeque<Option<i32>>,
    sorted: Vec<Option<i32>>,
}

impl KthLargest {
    /// Before the first frame.
    pub fn new(k: u8, n: u8) -> Self {
        let (k, n) = (usize::from(k), usize::from(n));
        Self { k, n, recent: VecDeque::with_capacity(n + 1), sorted: Vec::with_capacity(n) }
    }

    /// Take the margin of the next frame in. `None`, of a frame and of the result, is below every threshold.
    pub fn push(&mut self, margin_q10: Option<i32>) -> Option<i32> {
        self.recent.push_back(margin_q10);
        if self.recent.len() > self.n {
            self.recent.pop_front();
        }
        self.sorted.clear();
        self.sorted.extend(&self.recent);
        self.sorted.sort_unstable_by(|a, b| b.cmp(a));
        self.sorted.get(self.k - 1).copied().flatten()
    }

    /// Forget all frames.
    pub fn clear(&mut self) {
        self.recent.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn by_hand() {
        let mut second_of_three = KthLargest::new(2, 3);
        let margins = [Some(5), Some(-1), None, Some(7), Some(7), Some(9), Some(0), None];
        let expected = [None, Some(-1), Some(-1), Some(-1), Some(7), Some(7), Some(7), Some(0)];
        assert_eq!(margins.map(|margin| second_of_three.push(margin)), expected);
        second_of_three.clear();
        assert_eq!(second_of_three.push(Some(9)), None, "one frame is not two");
    }
}
