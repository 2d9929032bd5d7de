//! The node: what is on the bus, published.
//!
//! | topic | type | how |
//! |---|---|---|
//! | `NAMESPACE/node42/slip` | `slipsense_msgs/Slip` | reliable, the last 10 |
//! | `NAMESPACE/node42/sensor0/raw` | `slipsense_msgs/Raw` | best effort, the last 5 |
//! | `NAMESPACE/node42/sensor0/pressure` | `sensor_msgs/Image` | best effort, the last 5 |
//!
//! A topic begins with the first message that belongs to it. The middleware is RustDDS through ros2-client: it speaks
//! with every DDS implementation that ROS 2 has, and needs no ROS to build or to run.

use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow};
use futures::executor::block_on;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{
    Context as Ros, ContextOptions, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
};
use slipsense::wire::{NodeId, Received};
use slipsense_recording::decode::{Count, Decoder};
use slipsense_recording::link::{Input, Source};

use crate::messages::{Image, Raw, RosMessage, Slip, sensor_topic, slip_topic};

/// Slip messages that wait for a slow subscriber; then the oldest goes.
const SLIP_DEPTH: u32 = 10;
/// The same of raw messages and pressure.
const RAW_DEPTH: u32 = 5;

/// How often a waiting node looks for a subscriber.
const WAIT_POLL: Duration = Duration::from_millis(20);

/// A subscriber that we know of may need as long to know of us; what is published before does not reach it.
const SETTLE: Duration = Duration::from_millis(500);

pub struct Options {
    /// Before every topic, such as `/slipsense`.
    pub namespace: String,
    pub domain_id: u16,
    /// A recording's frames come when they came; else as they are received.
    pub paced: bool,
    /// With a recording: wait so long for a subscriber of the first topic.
    pub wait: Duration,
}

#[derive(Debug, serde::Serialize)]
pub struct Published {
    pub messages: u64,
    /// What was on the bus, by node.
    pub nodes: BTreeMap<u8, Count>,
}

/// Publish what the source says until it ends or `stop` is set.
///
/// # Errors
/// If the source fails, or the middleware.
pub fn run(mut source: Source, options: &Options, stop: &AtomicBool) -> Result<Published> {
    let mut topics = Topics::new(options)?;
    let mut decoder = Decoder::new();
    let mut pace: Option<(Instant, u64)> = None;
    while !stop.load(Ordering::Relaxed) {
        let entry = match source.receive()? {
            Input::Frame(entry) => entry,
            Input::Other(_) | Input::Idle => continue,
            Input::End => break,
        };
        let time_us = entry.timestamp_us;
        let Some(decoded) = decoder.accept(&entry.frame) else { continue };
        if options.paced {
            if pace.is_none() {
                topics.wait_for_subscriber(decoded.node, options.wait, stop)?;
            }
            let &mut (began, first_us) = pace.get_or_insert((Instant::now(), time_us));
            let due = began + Duration::from_micros(time_us.saturating_sub(first_us));
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        topics.publish(decoded.node, &decoded.message, time_us)?;
    }
    Ok(Published { messages: topics.messages, nodes: decoder.counts() })
}

struct Topics {
    node: Node,
    namespace: String,
    slip: Publishers<Slip>,
    raw: Publishers<Raw>,
    pressure: Publishers<Image>,
    messages: u64,
}

type Publishers<M> = HashMap<String, Publisher<M>>;

impl Topics {
    fn new(options: &Options) -> Result<Self> {
        let ros = Ros::with_options(ContextOptions::new().domain_id(options.domain_id));
        let ros = ros.map_err(|error| anyhow!("cannot join DDS domain {}: {error}", options.domain_id))?;
        let name = NodeName::new("/", "slipsense").map_err(|error| anyhow!("{error:?}"))?;
        let node = ros.new_node(name, NodeOptions::new());
        let mut node = node.map_err(|error| anyhow!("cannot make a node: {error:?}"))?;
        let spinner = node.spinner().map_err(|error| anyhow!("cannot run the node: {error}"))?;
        thread::Builder::new().name("discovery".to_owned()).spawn(move || block_on(spinner.spin()))?;
        let namespace = options.namespace.clone();
        let (slip, raw, pressure) = Default::default();
        Ok(Self { node, namespace, slip, raw, pressure, messages: 0 })
    }

    fn publish(&mut self, node: NodeId, message: &Received, time_us: u64) -> Result<()> {
        let Self { node: ros, namespace, slip, raw, pressure, messages } = self;
        let full = |topic: String| format!("{namespace}/{topic}");
        match message {
            Received::Slip(message) => {
                let topic = publisher(slip, ros, full(slip_topic(node)), slip_qos())?;
                put(topic, Slip::new(node, message, time_us), messages)
            }
            Received::Raw(message) => {
                let topic = |what| full(sensor_topic(node, message.sensor, what));
                let samples = publisher(raw, ros, topic("raw"), raw_qos())?;
                put(samples, Raw::new(node, message, time_us), messages)?;
                let taxels = publisher(pressure, ros, topic("pressure"), raw_qos())?;
                put(taxels, Image::new(node, message, time_us), messages)
            }
        }
    }

    /// Make a node's slip topic and wait until somebody listens to it, `wait` at most.
    fn wait_for_subscriber(&mut self, node: NodeId, wait: Duration, stop: &AtomicBool) -> Result<()> {
        let topic = format!("{}/{}", self.namespace, slip_topic(node));
        let slip = publisher(&mut self.slip, &mut self.node, topic, slip_qos())?;
        let until = Instant::now() + wait;
        while slip.get_subscription_count(&self.node) == 0
            && Instant::now() < until
            && !stop.load(Ordering::Relaxed)
        {
            thread::sleep(WAIT_POLL);
        }
        if slip.get_subscription_count(&self.node) > 0 {
            thread::sleep(SETTLE);
        }
        Ok(())
    }
}

fn slip_qos() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_reliable(WhenFull::DEFAULT)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: SLIP_DEPTH as _ })
}

fn raw_qos() -> QosProfile {
    QosProfile::publisher_default()
        .reliability_best_effort()
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: RAW_DEPTH as _ })
}

/// The publisher of a topic, made when it is first asked for.
fn publisher<'a, M: RosMessage>(
    publishers: &'a mut Publishers<M>,
    ros: &mut Node,
    topic: String,
    qos: QosProfile,
) -> Result<&'a Publisher<M>> {
    Ok(match publishers.entry(topic) {
        Entry::Occupied(publisher) => publisher.into_mut(),
        Entry::Vacant(vacant) => {
            let topic = vacant.key();
            let (space, base) = topic.rsplit_once('/').unwrap_or(("", topic));
            let name = Name::new(space, base).map_err(|error| anyhow!("topic {topic}: {error:?}"))?;
            let dds = ros.create_topic(&name, MessageTypeName::new(M::PACKAGE, M::NAME), &qos);
            let dds = dds.map_err(|error| anyhow!("topic {topic}: {error}"))?;
            let publisher = ros.create_publisher(&dds, None);
            let publisher = publisher.map_err(|error| anyhow!("topic {topic}: {error}"))?;
            vacant.insert(publisher)
        }
    })
}

fn put<M: RosMessage>(publisher: &Publisher<M>, message: M, messages: &mut u64) -> Result<()> {
    publisher.publish(message).map_err(|error| anyhow!("cannot publish: {error}"))?;
    *messages += 1;
    Ok(())
}
