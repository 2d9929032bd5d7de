//! `slipsense-ros2`: a ROS 2 node for the module, and recordings as bags.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use clap::{Args, Parser, Subcommand};
use slipsense::calibration::SECONDS_MAX;
use slipsense_recording::link::{Place, open};
use slipsense_recording::log_file::Format;
use slipsense_ros2::{bag, node};

static STOP: AtomicBool = AtomicBool::new(false);

/// The slip-sensing module in ROS 2: a node, and recordings as bags. Needs no ROS to build or run
#[derive(Parser)]
#[command(name = "slipsense-ros2", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Node(NodeArgs),
    Bag(BagArgs),
}

/// Publish slip messages, accelerometer samples, pressure and diagnostics of every module on the bus
///
/// Ends with the source or by Ctrl-C. A recording is published at the pace at which it was recorded, one in a file
/// as one through a pipe. On a live bus the node asks modules, from address 125, for the taxels that they leave out,
/// and offers the service `tare`, which measures an untouched array as `slipsense calibrate` does.
#[derive(Args)]
#[command(after_help = "\
Topics, with the address of each module:
  /slipsense/node42/slip              slipsense_msgs/Slip, 240 Hz, reliable
  /slipsense/node42/info              slipsense_msgs/Info, after a change, reliable, latched
  /slipsense/node42/sensor0/raw       slipsense_msgs/Raw, best effort
  /slipsense/node42/sensor0/counts    sensor_msgs/Image, 32 x 32 mono16, best effort
  /slipsense/node42/sensor0/pressure  sensor_msgs/Image, 32 x 32 32FC1, kPa, best effort, once calibrated
  /diagnostics                        diagnostic_msgs/DiagnosticArray, once a second, reliable

Service:
  /slipsense/node42/sensor0/tare      std_srvs/Trigger

Examples:
  slipsense-ros2 node socketcan:can0
  slipsense-ros2 node out/demo/can.log          # no hardware: the demo, in real time
  ros2 topic echo /slipsense/node42/slip        # with slipsense_msgs built by colcon")]
struct NodeArgs {
    /// socketcan:can0, slcan:/dev/ttyACM0, slcan:HOST:PORT, a recording, or - for candump lines
    #[arg(value_name = "SOURCE")]
    source: Place,
    /// What every topic begins with
    #[arg(long, value_name = "NAME", default_value = "/slipsense", value_parser = namespace)]
    namespace: String,
    /// The DDS domain; without it that of ROS_DOMAIN_ID, or 0
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=232))]
    domain_id: Option<u16>,
    /// With a recording: wait so long for the first subscriber, seconds
    #[arg(long, value_name = "S", default_value = "0")]
    wait: u64,
    /// Send nothing on the bus: no tare, and no pressure where taxels are masked
    #[arg(long)]
    listen: bool,
    /// How long a tare measures, seconds
    #[arg(long, value_name = "S", default_value = "10", value_parser = clap::value_parser!(u8).range(1..=SECONDS_MAX as i64))]
    tare_seconds: u8,
    /// Bit rate of the data phase that an slcan adapter is set to, Mbit/s
    #[arg(long, value_name = "MBIT", default_value = "8", value_parser = clap::value_parser!(u8).range(1..=8))]
    data_mbit: u8,
    /// Print the counts as JSON
    #[arg(long)]
    json: bool,
}

/// Write a recording of the bus as a bag of ROS 2, in MCAP
///
/// The bag has the node's topics and can be played, plotted and converted by what ROS 2 has. The CAN frames stay in
/// the recording.
#[derive(Args)]
#[command(after_help = "\
Examples:
  slipsense-ros2 bag grasp.mcap grasp_bag
  ros2 bag play grasp_bag")]
struct BagArgs {
    /// A recording: .mcap or .log
    #[arg(value_name = "RECORDING")]
    recording: PathBuf,
    /// The folder to make
    #[arg(value_name = "BAG")]
    out: PathBuf,
    /// What every topic begins with
    #[arg(long, value_name = "NAME", default_value = "/slipsense", value_parser = namespace)]
    namespace: String,
    /// Print the counts as JSON
    #[arg(long)]
    json: bool,
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

/// A name of ROS from the root: `/` and words of letters, digits and single underscores.
fn namespace(text: &str) -> Result<String, String> {
    let word = |word: &str| {
        word.starts_with(|c: char| c.is_ascii_alphabetic())
            && word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_')
            && !word.contains("__")
    };
    match text.strip_prefix('/') {
        Some(words) if words.split('/').all(word) => Ok(text.to_owned()),
        _ => Err("must be /NAME or /NAME/NAME, of letters, digits and single underscores".to_owned()),
    }
}

impl NodeArgs {
    fn run(self) -> Result<()> {
        let domain_id = match self.domain_id {
            Some(id) => id,
            None => domain_of_environment()?,
        };
        let source = open(&self.source, self.data_mbit)?;
        ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
        let wait = matches!(self.source, Place::File(..)).then_some(Duration::from_secs(self.wait));
        let tare_seconds = (self.source.is_live() && !self.listen).then_some(self.tare_seconds);
        let options = node::Options { namespace: self.namespace, domain_id, wait, tare_seconds };
        let published = node::run(source, &options, &STOP)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&published)?);
            return Ok(());
        }
        println!("{} messages published", published.messages);
        published.notes.iter().for_each(|note| println!("  {note}"));
        for (node, count) in published.nodes {
            println!(
                "  node {node}: {} slip messages, {} lost; {} raw messages, {} lost; {} errors",
                count.slip, count.slip_lost, count.raw, count.raw_lost, count.errors
            );
        }
        Ok(())
    }
}

fn domain_of_environment() -> Result<u16> {
    match std::env::var("ROS_DOMAIN_ID") {
        Err(_) => Ok(0),
        Ok(text) if text.is_empty() => Ok(0),
        Ok(text) => match text.parse() {
            Ok(id) if id <= 232 => Ok(id),
            _ => anyhow::bail!("ROS_DOMAIN_ID: {text:?} must be 0 to 232"),
        },
    }
}

impl BagArgs {
    fn run(self) -> Result<()> {
        let Some(format) = Format::from_path(&self.recording) else {
            anyhow::bail!("{}: must end in .mcap or .log", self.recording.display())
        };
        let written = bag::write(&self.out, &self.recording, format, &self.namespace)?;
        if self.json {
            println!("{}", serde_json::to_string_pretty(&written)?);
            return Ok(());
        }
        println!("{}:", self.out.display());
        written.notes.iter().for_each(|note| println!("  {note}"));
        for (topic, messages) in written.messages {
            println!("  {messages:6} {topic}");
        }
        Ok(())
    }
}
