//! The node: what is on the bus, published, and a service that tares an array.
//!
//! A topic begins with the first message that belongs to it.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::Duration;

use anyhow::{Context, Result};
use serde::Serialize;
use slipsense::calibration::SECONDS_MAX;
use slipsense_recording::decode::Count;
use slipsense_recording::link::{Input, Place, now_us, open};

use crate::middleware::{Middleware, STOP};
use crate::services::Services;
use crate::topics::{Topics, namespace};

/// Publish slip messages, accelerometer samples, pressure and diagnostics of every module on the bus
///
/// Ends with the source or by Ctrl-C. A recording is published at the pace at which it was recorded, one in a file
/// as one through a pipe. On a live bus the node asks modules, from address 125, for the taxels that they leave out,
/// and offers the service `tare`, which measures an untouched array as `slipsense calibrate` does.
#[derive(clap::Args)]
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
pub struct Args {
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

#[derive(Serialize)]
struct Published {
    messages: u64,
    /// What was on the bus, by node.
    nodes: BTreeMap<u8, Count>,
    /// What a recording has and no message says, in words.
    notes: Vec<String>,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let published = self.publish()?;
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

    /// Publish what the source says until it ends or somebody asks to stop.
    fn publish(&self) -> Result<Published> {
        let domain_id = self.domain_id.map_or_else(domain_of_environment, Ok)?;
        let mut source = open(&self.source, self.data_mbit)?;
        ctrlc::set_handler(|| STOP.store(true, Ordering::Relaxed)).context("cannot listen for Ctrl-C")?;
        let wait = matches!(self.source, Place::File(..)).then_some(Duration::from_secs(self.wait));
        let may_ask = self.source.is_live() && !self.listen;
        let mut topics = Topics::new(&self.namespace);
        let mut ros = Middleware::new(domain_id, wait)?;
        let mut services = may_ask.then(|| Services::new(self.tare_seconds));
        while !STOP.load(Ordering::Relaxed) {
            match source.receive()? {
                Input::Frame(entry) => topics.entry(&entry, &mut ros)?,
                Input::Idle if wait.is_none() => topics.tick(now_us(), &mut ros)?,
                Input::Idle | Input::Other(_) => {}
                Input::End => break,
            }
            if let Some(services) = &mut services {
                services.serve(&mut source, &mut topics, &mut ros)?;
            }
        }
        Ok(Published { messages: ros.messages, nodes: topics.decoder.counts(), notes: source.notes() })
    }
}

fn domain_of_environment() -> Result<u16> {
    let text = std::env::var("ROS_DOMAIN_ID").unwrap_or_default();
    match text.parse() {
        Ok(id @ 0..=232) => Ok(id),
        _ if text.is_empty() => Ok(0),
        _ => anyhow::bail!("ROS_DOMAIN_ID: {text:?} must be 0 to 232"),
    }
}
