//! The node: what is on the bus, published, and a service that tares an array.
//!
//! A topic begins with the first message that belongs to it. The middleware is RustDDS through ros2-client: it speaks
//! with every DDS implementation that ROS 2 has, and needs no ROS to build or to run.

use std::any::Any;
use std::collections::{BTreeMap, HashMap};
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use futures::executor::block_on;
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{
    Context as Ros, ContextOptions, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
};
use slipsense_recording::decode::Count;
use slipsense_recording::link::{Input, Source, now_us};

use crate::messages::{Qos, RosMessage, Slip};
use crate::services::Services;
use crate::topics::{Sink, Topics};

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
    /// How long a service measures an array; `None`: nothing is sent on the bus.
    pub tare_seconds: Option<u8>,
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
    let mut topics = Topics::new(&options.namespace);
    let mut ros = Middleware::new(options, stop)?;
    let mut services = options.tare_seconds.map(Services::new);
    while !stop.load(Ordering::Relaxed) {
        match source.receive()? {
            Input::Frame(entry) => topics.entry(&entry, &mut ros)?,
            Input::Idle if !options.paced => topics.tick(now_us(), &mut ros)?,
            Input::Idle | Input::Other(_) => {}
            Input::End => break,
        }
        if let Some(services) = &mut services {
            services.serve(&mut source, &mut topics, &mut ros)?;
        }
    }
    Ok(Published { messages: ros.messages, nodes: topics.decoder.counts() })
}

pub struct Middleware<'o> {
    options: &'o Options,
    pub stop: &'o AtomicBool,
    pub node: Node,
    /// By topic: a `Publisher` of its type.
    publishers: HashMap<String, Box<dyn Any>>,
    /// When a recording began, and the time of its first message there.
    began: Option<(Instant, u64)>,
    messages: u64,
}

impl<'o> Middleware<'o> {
    fn new(options: &'o Options, stop: &'o AtomicBool) -> Result<Self> {
        let ros = Ros::with_options(ContextOptions::new().domain_id(options.domain_id));
        let ros = ros.map_err(|error| anyhow!("cannot join DDS domain {}: {error}", options.domain_id))?;
        let name = NodeName::new("/", "slipsense").map_err(|error| anyhow!("{error:?}"))?;
        let node = ros.new_node(name, NodeOptions::new());
        let mut node = node.map_err(|error| anyhow!("cannot make a node: {error:?}"))?;
        let spinner = node.spinner().map_err(|error| anyhow!("cannot run the node: {error}"))?;
        thread::Builder::new().name("discovery".to_owned()).spawn(move || block_on(spinner.spin()))?;
        Ok(Self { options, stop, node, publishers: HashMap::new(), began: None, messages: 0 })
    }

    /// Make the publisher of a topic where there is none.
    fn publisher<M: RosMessage>(&mut self, topic: &str) -> Result<&Publisher<M>> {
        if !self.publishers.contains_key(topic) {
            let (name, kind) = (name(topic)?, MessageTypeName::new(M::PACKAGE, M::NAME));
            let dds = self.node.create_topic(&name, kind, &profile(M::QOS));
            let dds = dds.map_err(|error| anyhow!("topic {topic}: {error}"))?;
            let publisher = self.node.create_publisher::<M>(&dds, None);
            let publisher = publisher.map_err(|error| anyhow!("topic {topic}: {error}"))?;
            self.publishers.insert(topic.to_owned(), Box::new(publisher));
        }
        let publisher = self.publishers.get(topic).and_then(|publisher| publisher.downcast_ref());
        publisher.with_context(|| format!("topic {topic}: has two types"))
    }

    /// Until a recording's message is due. The first slip message waits for somebody who listens.
    fn pace<M: RosMessage>(&mut self, topic: &str, time_us: u64) -> Result<()> {
        if self.began.is_none() && M::NAME == Slip::NAME {
            let until = Instant::now() + self.options.wait;
            self.publisher::<M>(topic)?;
            let is_heard = |ros: &mut Self| {
                let (node, publisher) = (&ros.node, ros.publishers.get(topic));
                publisher
                    .and_then(|publisher| publisher.downcast_ref::<Publisher<M>>())
                    .is_some_and(|publisher| publisher.get_subscription_count(node) > 0)
            };
            while !is_heard(self) && Instant::now() < until && !self.stop.load(Ordering::Relaxed) {
                thread::sleep(WAIT_POLL);
            }
            if is_heard(self) {
                thread::sleep(SETTLE);
            }
            self.began = Some((Instant::now(), time_us));
        }
        if let Some((began, first_us)) = self.began {
            let due = began + Duration::from_micros(time_us.saturating_sub(first_us));
            thread::sleep(due.saturating_duration_since(Instant::now()));
        }
        Ok(())
    }
}

impl Sink for Middleware<'_> {
    fn put<M: RosMessage>(&mut self, topic: &str, message: &M, time_us: u64) -> Result<()> {
        if self.options.paced {
            self.pace::<M>(topic, time_us)?;
        }
        let publisher = self.publisher::<M>(topic)?;
        publisher.publish(message.clone()).map_err(|error| anyhow!("cannot publish: {error}"))?;
        self.messages += 1;
        Ok(())
    }
}

/// A topic or a service, from the root on.
pub fn name(topic: &str) -> Result<Name> {
    let (space, base) = topic.rsplit_once('/').unwrap_or(("", topic));
    let space = if space.is_empty() { "/" } else { space };
    Name::new(space, base).map_err(|error| anyhow!("topic {topic}: {error:?}"))
}

pub fn profile(qos: Qos) -> QosProfile {
    let reliability = match qos.reliable {
        true => Reliability::Reliable { when_full: WhenFull::DEFAULT },
        false => Reliability::BestEffort,
    };
    QosProfile::publisher_default()
        .reliability(reliability)
        .durability(if qos.latched { Durability::TransientLocal } else { Durability::Volatile })
        .history(History::KeepLast { depth: qos.depth as _ })
}
