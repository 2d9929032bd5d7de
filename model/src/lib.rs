//! Definition, trainer and quantizer of the network.
//!
//! Episodes become features by the microcontroller's own front end ([`data`]), random stretches of them
//! become batches ([`batch`], [`augment`]), a tensor library trains the network on whole sequences
//! ([`float`], [`train`]). The weights ([`weights`]) are run frame by frame to measure ranges
//! ([`reference`]), turned into integers ([`quantize`]), and scored beside the integer pipeline
//! ([`evaluate`]). Networks that differ from it in one thing each are compared with it ([`variants`]).

pub mod augment;
pub mod batch;
pub mod checkpoint;
pub mod command;
pub mod data;
pub mod evaluate;
pub mod export;
pub mod float;
pub mod output;
pub mod pad_view;
pub mod piezo;
pub mod quantize;
pub mod reference;
pub mod train;
pub mod variants;
pub mod weights;

pub use command::{QuantizeArgs, run_quantize};
pub use train::{TrainArgs, run_train};
pub use variants::{CompareArgs, run_compare};
