//! The network: kernels, model file, streaming graph. `batch` is the oracle, `inputs` what it is fed.

mod batch;
mod contact;
mod convolution;
mod cost;
mod decision;
mod inputs;
mod kernels;
mod model_file;
mod pipeline;
mod streaming;
