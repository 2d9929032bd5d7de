//! Definition, trainer and quantizer of the network.
//!
//! Episodes, generated or from a folder ([`folder`]), become features by the microcontroller's own front end
//! ([`data`]); random stretches of them become batches ([`batch`], [`augment`]). A tensor library trains the network on
//! whole sequences ([`float`], [`train`], with a [`teacher`] if there is one), its detector on events ([`target`]); the taxel encoder's convolutions are
//! our own ([`piezo`]). Another library runs the [`weights`] frame by frame ([`tract`]) to measure the ranges of all
//! activations ([`trace`]). They are turned into integers ([`quantize`]) and scored beside the integer pipeline
//! ([`evaluate`]), activation by activation if need be ([`compare`]). [`variants`] are networks that differ in one thing
//! each, and the paper's own with its [`encoders`].

pub mod augment;
pub mod batch;
pub mod checkpoint;
pub mod command;
pub mod curves;
pub mod compare;
pub mod data;
mod detector_loss;
pub mod device;
pub mod encoders;
pub mod evaluate;
pub mod export;
pub mod float;
pub mod folder;
pub mod mean;
pub mod mining;
pub mod output;
pub mod pad_view;
mod picture;
pub mod piezo;
mod progress;
pub mod quantize;
pub mod real_parts;
pub mod target;
pub mod teacher;
mod tensors_file;
pub mod trace;
pub mod tract;
pub mod train;
pub mod variants;
pub mod weights;

pub use command::{QuantizeArgs, run_quantize};
pub use mining::{MineArgs, run_mine};
pub use train::{TrainArgs, run_train};
pub use variants::{BudgetName, LeaveOutArgs, REPORT_FILE, ReproduceArgs, run_leave_out, run_reproduce};
