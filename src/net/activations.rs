//! Activations on the way from layer to layer: 16-bit numbers, two per word, as the kernels read them.

/// A vector of `2 · WORDS` activations at most; what a model does not use stays 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Activations<const WORDS: usize>([u32; WORDS]);

impl<const WORDS: usize> Activations<WORDS> {
    /// All zero.
    pub const fn new() -> Self {
        Self([0; WORDS])
    }

    /// Two by two.
    #[inline]
    pub const fn words(&self) -> &[u32; WORDS] {
        &self.0
    }

    /// One by one.
    #[inline]
    pub fn values(&self) -> &[i16] {
        bytemuck::must_cast_slice(&self.0)
    }

    /// One by one, to be written.
    #[inline]
    pub fn values_mut(&mut self) -> &mut [i16] {
        bytemuck::must_cast_slice_mut(&mut self.0)
    }
}
