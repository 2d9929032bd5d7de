//! Definition, trainer and quantizer of the network.
//!
//! Episodes, generated or from a folder ([`folder`]), become features by the microcontroller's own front end
//! ([`data`]), random stretches of them become batches ([`batch`], [`augment`]), a tensor library trains the
//! network on whole sequences ([`float`], [`train`], the taxel encoder's convolutions by hand in [`piezo`]). The
//! weights ([`weights`]) are run frame by frame to measure ranges ([`reference`]), turned into integers
//! ([`quantize`]), and scored beside the integer pipeline ([`evaluate`]).

pub mod augment;
pub mod batch;
pub mod checkpoint;
pub mod command;
pub mod curves;
pub mod data;
pub mod evaluate;
pub mod export;
pub mod float;
pub mod folder;
pub mod output;
pub mod piezo;
pub mod quantize;
pub mod reference;
pub mod train;
pub mod weights;

pub use command::{QuantizeArgs, run_quantize};
pub use train::{TrainArgs, run_train};
