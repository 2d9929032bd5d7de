//! The kernels for cores with the DSP extension, such as the Cortex-M7: assembly, bit-equal to
//! [`portable`](super::portable). Every function checks the lengths that its assembly reads and writes.

mod attention;
mod conv;
mod dense;

pub use attention::{dots, weighted_sums};
pub use conv::conv_relu_pool;
pub use dense::dense;
