//! `slipsense-ros2` brings the module to ROS 2: a node publishes its messages, and recordings become bags.

mod bag;
mod diagnostics;
mod messages;
mod middleware;
mod module;
mod node;
mod services;
mod topics;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The slip-sensing module in ROS 2: a node, and recordings as bags. Needs no ROS to build or run
#[derive(Parser)]
#[command(name = "slipsense-ros2", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Node(node::Args),
    Bag(bag::Args),
}

fn main() -> ExitCode {
    let done = match Cli::parse().command {
        Command::Node(args) => args.run(),
        Command::Bag(args) => args.run(),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::from(2)
        }
    }
}
