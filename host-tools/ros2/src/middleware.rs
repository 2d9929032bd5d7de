//! The middleware: RustDDS through ros2-client, which speaks with every DDS that ROS 2 has, and needs no ROS to build or
//! to run.

use std::any::Any;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, anyhow};
use futures::executor::block_on;
use ros2_client::qos::{Durability, History, Reliability, WhenFull};
use ros2_client::{
    Context as Ros, ContextOptions, MessageTypeName, Name, Node, NodeName, NodeOptions, Publisher, QosProfile,
};

use crate::messages::{Qos, RosMessage, Slip};
use crate::topics::Sink;

/// Somebody asked the node to stop.
pub static STOP: AtomicBool = AtomicBool::new(false);

/// How often a waiting node looks for a subscriber.
const WAIT_POLL: Duration = Duration::from_millis(20);

/// A subscriber that we know of may need as long to know of us; what is published before does not reach it.
const SETTLE: Duration = Duration::from_millis(500);

pub struct Middleware {
    /// With a recording: wait so long for a subscriber of the first topic; then its frames come when they came.
    wait: Option<Duration>,
    pub node: Node,
    /// By topic: a `Publisher` of its type.
    publishers: HashMap<String, Box<dyn Any>>,
    /// When a recording began, and the time of its first message there.
    began: Option<(Instant, u64)>,
    pub messages: u64,
}

impl Middleware {
    pub fn new(domain_id: u16, wait: Option<Duration>) -> Result<Self> {
        let ros = Ros::with_options(ContextOptions::new().domain_id(domain_id));
        let ros = ros.map_err(|error| anyhow!("cannot join DDS domain {domain_id}: {error}"))?;
        let name = NodeName::new("/", "slipsense").map_err(|error| anyhow!("{error:?}"))?;
        let node = ros.new_node(name, NodeOptions::new());
        let mut node = node.map_err(|error| anyhow!("cannot make a node: {error:?}"))?;
        let spinner = node.spinner().map_err(|error| anyhow!("cannot run the node: {error}"))?;
        thread::Builder::new().name("discovery".to_owned()).spawn(move || block_on(spinner.spin()))?;
        Ok(Self { wait, node, publishers: HashMap::new(), began: None, messages: 0 })
    }

    /// Make the publisher of a topic where there is none.
    fn publisher<M: RosMessage>(&mut self, topic: &str) -> Result<&Publisher<M>> {
        if !self.publishers.contains_key(topic) {
            let (name, kind) = (name(topic)?, MessageTypeName::new(M::KIND.0, M::KIND.1));
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
    fn pace<M: RosMessage>(&mut self, topic: &str, time_us: u64, wait: Duration) -> Result<()> {
        if self.began.is_none() && M::KIND == Slip::KIND {
            let until = Instant::now() + wait;
            self.publisher::<M>(topic)?;
            let is_heard = |ros: &mut Self| {
                let (node, publisher) = (&ros.node, ros.publishers.get(topic));
                publisher
                    .and_then(|publisher| publisher.downcast_ref::<Publisher<M>>())
                    .is_some_and(|publisher| publisher.get_subscription_count(node) > 0)
            };
            while !is_heard(self) && Instant::now() < until && !STOP.load(Ordering::Relaxed) {
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

impl Sink for Middleware {
    fn put<M: RosMessage>(&mut self, topic: &str, message: M, time_us: u64) -> Result<()> {
        if let Some(wait) = self.wait {
            self.pace::<M>(topic, time_us, wait)?;
        }
        let publisher = self.publisher::<M>(topic)?;
        publisher.publish(message).map_err(|error| anyhow!("cannot publish: {error}"))?;
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
