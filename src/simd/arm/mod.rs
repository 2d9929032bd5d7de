//! The kernels for cores with the DSP extension, such as the Cortex-M7: assembly, bit-equal to
//! [`portable`](super::portable).
//!
//! Fourteen registers are all there is; each file says how it uses them.
//!
//! Every function checks the lengths that its assembly
//! reads and writes before it calls it.

mod attention;
mod conv;
mod dense;

pub use attention::{dots, weighted_sums};
pub use conv::conv_relu_pool;
pub use dense::dense;
