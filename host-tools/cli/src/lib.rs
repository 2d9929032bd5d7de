//! The `slipsense` command, as a library so that tests and other tools can drive its parts.
//!
//! An episode goes through [`simulate`], which runs the firmware's own pipeline and sends its CAN
//! frames; [`summary`] scores the result, [`picture`] and [`report`] show it, and [`output_dir`] makes
//! sure that a folder is written whole or not at all. [`commands`] puts these together.

pub mod simulate;
pub mod summary;
mod table;
pub mod picture;
pub mod report;
pub mod output_dir;
mod set_dir;
pub mod bundled;
mod signing;
pub mod grasp;
pub mod hil;
pub mod view;
pub mod commands;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Exit code of every error, the command line's own included.
const EXIT_ERROR: u8 = 2;

const ABOUT: &str = "Slip sensing for robot fingertips: run the firmware's signal path on a computer";

const LONG_ABOUT: &str = "\
Slip sensing for robot fingertips: run the firmware's signal path on a computer.

An episode is a stretch of sensor data in one .npz file: frames of a 32×32 pressure array at 240 Hz and \
accelerometer samples at 8 kHz, for one to three fingertips. Every command that reads one runs the same \
code as the microcontroller, bit for bit, and gets the same slip flags and the same CAN frames.";

const EXAMPLES: &str = "\
Examples:
  slipsense demo                                  a slip detected in a bundled synthetic episode
  slipsense run grasp.npz --out out/grasp         the same for a file of your own
  slipsense run grasp.npz --out out/grasp --json | jq .truth.events
  slipsense view grasp.npz                        pressure, sound and flags on a page of this computer
  slipsense synth --split umi_ood --out out/umi_ood
  slipsense label grasp.npz --manual 3.2:4.75 --object my-mug --out data/grasp.npz
  slipsense eval umi_ood --detector network --detector entropy --out out/eval
  slipsense record socketcan:can0 grasp.mcap      the bus, for Foxglove and for later
  slipsense grasp --out out/grasp                 a synthetic gripper that reacts to the flag
  slipsense busload --sensors 3                   what that does to a bus
  slipsense model info                            layers, cost and head-room of the bundled model

Errors are one line on standard error and exit code 2; a command that fails leaves no output behind,
but for the finished episodes of `synth`, which goes on from them.";

#[derive(Parser)]
#[command(name = "slipsense", version, about = ABOUT, long_about = LONG_ABOUT, after_help = EXAMPLES)]
#[command(max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::demo::Args),
    Run(commands::run::Args),
    View(commands::view::Args),
    Features(commands::features::Args),
    Synth(commands::synth::Args),
    Eval(commands::eval::Args),
    EvalRotation(commands::eval_rotation::Args),
    Fit(commands::fit::Args),
    Label(commands::label::Args),
    Train(commands::train::TrainArgs),
    Quantize(commands::train::QuantizeArgs),
    Model(commands::model::Args),
    Tune(commands::tune::Args),
    Grasp(commands::grasp::Args),
    Busload(commands::busload::Args),
    Sign(commands::sign::Args),
    Keygen(commands::keygen::Args),
    Image(commands::image::Args),
    Hil(commands::hil::Args),
    Record(commands::record::Args),
    Monitor(commands::monitor::Args),
    Replay(commands::replay::Args),
    Convert(commands::convert::Args),
    Dbc(commands::descriptions::DbcArgs),
    CHeader(commands::descriptions::CHeaderArgs),
    CompareNetworks(commands::train::CompareArgs),
}

/// Parse the command line, do what it says, and report an error in one line.
pub fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Demo(args) => args.run(),
        Command::Run(args) => args.run(),
        Command::View(args) => args.run(),
        Command::Features(args) => args.run(),
        Command::Synth(args) => args.run(),
        Command::Eval(args) => args.run(),
        Command::EvalRotation(args) => args.run(),
        Command::Fit(args) => args.run(),
        Command::Label(args) => args.run(),
        Command::Train(args) => commands::train::train(args),
        Command::Quantize(args) => commands::train::quantize(args),
        Command::Model(args) => args.run(),
        Command::Tune(args) => args.run(),
        Command::Grasp(args) => args.run(),
        Command::Busload(args) => args.run(),
        Command::Sign(args) => args.run(),
        Command::Keygen(args) => args.run(),
        Command::Image(args) => args.run(),
        Command::Hil(args) => match args.run() {
            Ok(true) => Ok(()),
            Ok(false) => return ExitCode::FAILURE,
            Err(error) => Err(error),
        },
        Command::Record(args) => args.run(),
        Command::Monitor(args) => args.run(),
        Command::Replay(args) => args.run(),
        Command::Convert(args) => args.run(),
        Command::Dbc(args) => args.run(),
        Command::CHeader(args) => args.run(),
        Command::CompareNetworks(args) => commands::train::compare(args),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        // A reader that closed the pipe early, such as `head`, has what it wanted.
        Err(error) if is_broken_pipe(&error) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {}", one_line(&error));
            ExitCode::from(EXIT_ERROR)
        }
    }
}

fn is_broken_pipe(error: &anyhow::Error) -> bool {
    let io = error.downcast_ref::<std::io::Error>();
    io.is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
}

/// The error and its causes on one line, whatever they are made of.
fn one_line(error: &anyhow::Error) -> String {
    format!("{error:#}").split_whitespace().collect::<Vec<_>>().join(" ")
}
