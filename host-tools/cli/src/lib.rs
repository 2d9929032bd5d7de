//! The `slipsense` command, as a library: a program and the Python package run it.
//!
//! An episode goes through [`simulate`], which runs the firmware's pipeline and makes its CAN frames; [`summary`]
//! scores the result, [`picture`] and [`report`] show it, [`output`] writes it whole or not at all. [`commands`] has a
//! file for each subcommand.

mod bundled;
#[cfg_attr(not(feature = "full"), allow(dead_code, reason = "the other commands use the rest"))]
mod output;
mod simulate;
mod summary;
mod picture;
mod report;
#[cfg(feature = "full")]
mod set_dir;
#[cfg(feature = "full")]
mod grasp;
#[cfg(feature = "full")]
mod hil;
#[cfg(feature = "full")]
mod page_server;
mod commands;

use std::ffi::OsString;
use std::io::{self, ErrorKind};

use anyhow::Result;
use clap::{CommandFactory, Parser, Subcommand};

/// Exit code of every error, the command line's own included.
const EXIT_ERROR: u8 = 2;
const HELP_COLUMNS: usize = 100;

const ABOUT: &str = "Slip sensing for robot fingertips: run the firmware's signal path on a computer";

const LONG_ABOUT: &str = "\
Slip sensing for robot fingertips: run the firmware's signal path on a computer.

An episode is a stretch of sensor data in one .npz file: frames of a 32×32 pressure array at 240 Hz and \
accelerometer samples at 8 kHz, for one to three fingertips. Every command that reads one runs the same \
code as the microcontroller, bit for bit, and gets the same slip flags and the same CAN frames.";

const EXAMPLES: &str = "\
Examples:
  slipsense demo                                  detect a slip in a bundled synthetic episode
  slipsense run grasp.npz --out out/grasp         the same for a file of your own
  slipsense run grasp.npz --out out/grasp --json | jq .truth.events
  slipsense view grasp.npz                        pressure, sound and flags on a page of this computer
  slipsense synth --split umi_ood --out out/umi_ood
  slipsense label grasp.npz --manual 3.2:4.75 --object my-mug --out data/grasp.npz
  slipsense eval umi_ood --detector network --detector entropy --out out/eval
  slipsense record socketcan:can0 grasp.mcap      the bus, for Foxglove and for later
  slipsense grasp --out out/grasp                 a synthetic gripper that reacts to slip
  slipsense busload --sensors 3                   the load of such a bus
  slipsense model info                            layers, cost and head-room of the bundled model

An error is one line on standard error and exit code 2. A command that fails leaves no output, except
`synth`: it keeps finished episodes and continues from them.";

#[derive(Parser)]
#[command(name = "slipsense", version, about = ABOUT, long_about = LONG_ABOUT, after_help = EXAMPLES)]
#[command(max_term_width = HELP_COLUMNS)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Demo(commands::run::DemoArgs),
    Run(commands::run::Args),
    Model(commands::model::Args),
    #[cfg(feature = "full")]
    #[command(flatten)]
    Full(commands::full::Command),
    /// A command of the full build
    #[cfg(not(feature = "full"))]
    #[command(external_subcommand)]
    NotInBuild(Vec<String>),
    /// Print the help of every command as one Markdown page
    #[command(hide = true)]
    HelpMarkdown,
}

/// Run one command line, the program's name first, and give its exit code. What is wrong is on standard error.
pub fn main(line: impl IntoIterator<Item = OsString>) -> u8 {
    match run(line) {
        Ok(()) => 0,
        // A reader that closed the pipe early, such as `head`, has what it wanted.
        Err(error)
            if error.downcast_ref::<io::Error>().is_some_and(|e| e.kind() == ErrorKind::BrokenPipe) =>
        {
            0
        }
        Err(error) => match error.downcast_ref::<clap::Error>() {
            // Help and version are among these. Nobody is left to tell that the terminal is gone.
            Some(usage) => {
                let _ = usage.print();
                if usage.use_stderr() { EXIT_ERROR } else { 0 }
            }
            None => {
                eprintln!("error: {}", one_line(&error));
                EXIT_ERROR
            }
        },
    }
}

/// Run one command line, the program's name first.
pub fn run(line: impl IntoIterator<Item = OsString>) -> Result<()> {
    match Cli::try_parse_from(line)?.command {
        Command::Demo(args) => args.run(),
        Command::Run(args) => args.run(),
        Command::Model(args) => args.run(),
        #[cfg(feature = "full")]
        Command::Full(command) => command.run(),
        #[cfg(not(feature = "full"))]
        Command::NotInBuild(line) => Err(anyhow::anyhow!(
            "`{}` is not in this build, which has demo, run and model; get it with `cargo run --release -- {}`",
            line[0],
            line.join(" ")
        )),
        Command::HelpMarkdown => commands::print(&help_markdown(Cli::command())),
    }
}

/// The error and its causes on one line, whatever they contain; of a wrong command line without the advice.
pub fn one_line(error: &anyhow::Error) -> String {
    let text = match error.downcast_ref::<clap::Error>() {
        Some(usage) => usage.to_string().split("\n\n").next().unwrap_or_default().replacen("error: ", "", 1),
        None => format!("{error:#}"),
    };
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// `--help` of a program and of all its commands, 100 columns wide whatever the terminal.
fn help_markdown(program: clap::Command) -> String {
    fn section(command: &mut clap::Command, page: &mut String) {
        let name = command.get_bin_name().unwrap_or(command.get_name()).to_owned();
        let help = command.render_long_help().to_string();
        let help: Vec<&str> = help.lines().map(str::trim_end).collect();
        *page += &format!("\n## {name}\n\n```text\n{}\n```\n", help.join("\n").trim_end());
        let shown = |command: &&mut clap::Command| !command.is_hide_set() && command.get_name() != "help";
        command.get_subcommands_mut().filter(shown).for_each(|command| section(command, page));
    }
    let mut program = program.term_width(HELP_COLUMNS);
    program.build();
    let mut page = "# Commands\n\nThe help of every command. A test holds this page equal to what the commands print. \
                    Commands that train show their\noptions with `cargo run --release --features train -- COMMAND --help`.\n"
        .to_owned();
    section(&mut program, &mut page);
    page
}
