//! The commands of the full build, besides `demo`, `run` and `model`.

mod busload;
mod calibrate;
mod convert;
mod descriptions;
mod eval;
mod families;
mod features;
mod fit;
mod grasp;
mod hil;
mod inputs;
mod label;
mod live;
mod monitor;
mod record;
mod replay;
mod signing;
mod synth;
#[cfg(feature = "train")]
mod train;
mod tune;
mod view;

use anyhow::Result;
use clap::Subcommand;
#[cfg(feature = "train")]
use slipsense_model::{
    LeaveOutArgs, MineArgs, QuantizeArgs, ReproduceArgs, TrainArgs, run_leave_out, run_mine, run_train,
};

#[cfg(not(feature = "train"))]
use super::NotInBuild;
use super::{ModelArg, Print, print, run::Raw, written};

#[derive(Subcommand)]
pub enum Command {
    View(view::Args),
    Features(features::Args),
    Synth(synth::Args),
    Eval(eval::Args),
    Families(families::Args),
    Fit(fit::Args),
    Label(label::Args),
    #[cfg(feature = "train")]
    Train(TrainArgs),
    /// Train the network on synthetic episodes (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Train(NotInBuild),
    #[cfg(feature = "train")]
    Quantize(QuantizeArgs),
    /// Turn a trained network into a model file (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Quantize(NotInBuild),
    #[cfg(feature = "train")]
    Mine(MineArgs),
    /// Find hard examples that a trained network takes for slip (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Mine(NotInBuild),
    Tune(tune::Args),
    Grasp(grasp::Args),
    Busload(busload::Args),
    Sign(signing::SignArgs),
    Keygen(signing::KeygenArgs),
    Image(signing::ImageArgs),
    Hil(hil::Args),
    Calibrate(calibrate::Args),
    Record(record::Args),
    Monitor(monitor::Args),
    Replay(replay::Args),
    Convert(convert::Args),
    Dbc(descriptions::DbcArgs),
    CHeader(descriptions::CHeaderArgs),
    #[cfg(feature = "train")]
    Reproduce(ReproduceArgs),
    /// Run the paper's comparisons: networks beside the shipped one, and the paper's own (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    Reproduce(NotInBuild),
    #[cfg(feature = "train")]
    LeaveOut(LeaveOutArgs),
    /// Train without one family of physics after the other (needs the feature `train`)
    #[cfg(not(feature = "train"))]
    LeaveOut(NotInBuild),
}

impl Command {
    pub fn run(self) -> Result<()> {
        match self {
            Self::View(args) => args.run(),
            Self::Features(args) => args.run(),
            Self::Synth(args) => args.run(),
            Self::Eval(args) => args.run(),
            Self::Families(args) => args.run(),
            Self::Fit(args) => args.run(),
            Self::Label(args) => args.run(),
            #[cfg(feature = "train")]
            Self::Train(args) => run_train(&args),
            #[cfg(not(feature = "train"))]
            Self::Train(args) => args.refuse("train"),
            #[cfg(feature = "train")]
            Self::Quantize(args) => train::quantize(&args),
            #[cfg(not(feature = "train"))]
            Self::Quantize(args) => args.refuse("quantize"),
            #[cfg(feature = "train")]
            Self::Mine(args) => run_mine(&args),
            #[cfg(not(feature = "train"))]
            Self::Mine(args) => args.refuse("mine"),
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
            #[cfg(feature = "train")]
            Self::Reproduce(args) => train::reproduce(&args),
            #[cfg(not(feature = "train"))]
            Self::Reproduce(args) => args.refuse("reproduce"),
            #[cfg(feature = "train")]
            Self::LeaveOut(args) => run_leave_out(&args),
            #[cfg(not(feature = "train"))]
            Self::LeaveOut(args) => args.refuse("leave-out"),
        }
    }
}
