//! The commands of the full build, besides `demo`, `run` and `model`.

mod busload;
mod calibrate;
mod convert;
mod descriptions;
mod eval;
mod eval_rotation;
mod families;
mod features;
mod fit;
mod grasp;
mod hil;
mod image;
mod inputs;
mod keygen;
mod label;
mod live;
mod monitor;
mod record;
mod replay;
#[cfg(feature = "train")]
mod shipped;
mod sign;
mod synth;
mod train;
mod tune;
mod view;

use anyhow::Result;
use clap::Subcommand;

use super::{ModelArg, Print, print, run::Raw, written};

#[derive(Subcommand)]
pub enum Command {
    View(view::Args),
    Features(features::Args),
    Synth(synth::Args),
    Eval(eval::Args),
    EvalRotation(eval_rotation::Args),
    Families(families::Args),
    Fit(fit::Args),
    Label(label::Args),
    #[cfg_attr(
        not(feature = "train"),
        doc = "Train the network on synthetic episodes (needs the feature `train`)"
    )]
    Train(train::TrainArgs),
    #[cfg_attr(
        not(feature = "train"),
        doc = "Turn a trained network into a model file (needs the feature `train`)"
    )]
    Quantize(train::QuantizeArgs),
    #[cfg_attr(
        not(feature = "train"),
        doc = "Find hard examples that a trained network takes for slip (needs the feature `train`)"
    )]
    Mine(train::MineArgs),
    Tune(tune::Args),
    Grasp(grasp::Args),
    Busload(busload::Args),
    Sign(sign::Args),
    Keygen(keygen::Args),
    Image(image::Args),
    Hil(hil::Args),
    Calibrate(calibrate::Args),
    Record(record::Args),
    Monitor(monitor::Args),
    Replay(replay::Args),
    Convert(convert::Args),
    Dbc(descriptions::DbcArgs),
    CHeader(descriptions::CHeaderArgs),
    #[cfg_attr(
        not(feature = "train"),
        doc = "Run the paper's comparisons: networks beside the shipped one, and the paper's own (needs the feature `train`)"
    )]
    Reproduce(train::ReproduceArgs),
    #[cfg_attr(
        not(feature = "train"),
        doc = "Train without one family of physics after the other (needs the feature `train`)"
    )]
    LeaveOut(train::LeaveOutArgs),
}

impl Command {
    pub fn run(self) -> Result<()> {
        match self {
            Self::View(args) => args.run(),
            Self::Features(args) => args.run(),
            Self::Synth(args) => args.run(),
            Self::Eval(args) => args.run(),
            Self::EvalRotation(args) => args.run(),
            Self::Families(args) => args.run(),
            Self::Fit(args) => args.run(),
            Self::Label(args) => args.run(),
            Self::Train(args) => train::train(&args),
            Self::Quantize(args) => train::quantize(&args),
            Self::Mine(args) => train::mine(&args),
            Self::Tune(args) => args.run(),
            Self::Grasp(args) => args.run(),
            Self::Busload(args) => args.run(),
            Self::Sign(args) => args.run(),
            Self::Keygen(args) => args.run(),
            Self::Image(args) => args.run(),
            Self::Hil(args) => args.run(),
            Self::Calibrate(args) => args.run(),
            Self::Record(args) => args.run(),
            Self::Monitor(args) => args.run(),
            Self::Replay(args) => args.run(),
            Self::Convert(args) => args.run(),
            Self::Dbc(args) => args.run(),
            Self::CHeader(args) => args.run(),
            Self::Reproduce(args) => train::reproduce(&args),
            Self::LeaveOut(args) => train::leave_out(&args),
        }
    }
}
