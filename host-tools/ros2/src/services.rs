//! What the node asks modules for: which taxels they leave out, and a tare where somebody calls the service.

use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use anyhow::{Result, anyhow, ensure};
use ros2_client::{Message, RmwRequestId, Server, ServiceMapping, ServiceTypeName};
use serde::{Deserialize, Serialize};
use slipsense::node::CALIBRATE;
use slipsense::wire::NodeId;
use slipsense_recording::candump::LogEntry;
use slipsense_recording::client::{Bus, Client};
use slipsense_recording::link::{Source, now_us};

use crate::messages::RELIABLE;
use crate::middleware::{Middleware, STOP, name, profile};
use crate::module::mask_register;
use crate::topics::Topics;

/// The node's address on the bus. `slipsense calibrate` has 126.
const OWN: NodeId = NodeId::new(125).unwrap();
/// How often services look for calls.
const POLL: Duration = Duration::from_millis(50);
/// How often modules are asked for their masks: taxels may get stuck.
const ASK: Duration = Duration::from_secs(10);

/// `std_srvs/Trigger`: what DDS sends where ROS sends nothing.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Request {
    structure_needs_at_least_one_member: u8,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct Response {
    success: bool,
    message: String,
}

impl Message for Request {}
impl Message for Response {}

pub struct Services {
    tare_seconds: u8,
    clients: BTreeMap<NodeId, Client>,
    tares: BTreeMap<(NodeId, u8), Server<Request, Response>>,
    looked: Instant,
    asked: Option<Instant>,
}

impl Services {
    pub fn new(tare_seconds: u8) -> Self {
        let (clients, tares) = Default::default();
        Self { tare_seconds, clients, tares, looked: Instant::now(), asked: None }
    }

    /// Do what is due. A tare takes its time, in which the bus is published.
    pub fn serve(&mut self, source: &mut Source, topics: &mut Topics, ros: &mut Middleware) -> Result<()> {
        if self.looked.elapsed() < POLL {
            return Ok(());
        }
        self.looked = Instant::now();
        self.offer(topics, ros)?;
        if self.asked.is_none_or(|asked| asked.elapsed() >= ASK) {
            self.asked = Some(Instant::now());
            for &(node, sensor) in self.tares.keys() {
                let client = self.clients.entry(node).or_insert_with(|| Client::new(OWN, node));
                for frame in client.read(&mask_register(sensor.into())) {
                    source.send(&frame)?;
                    // Who hears the answer has to know the question.
                    let (timestamp_us, interface) = (now_us(), String::new());
                    topics.entry(&LogEntry { timestamp_us, interface, frame }, ros)?;
                }
            }
        }
        for (node, sensor, id) in self.calls()? {
            let said = self.tare(node, sensor, source, topics, ros);
            let (success, message) = match said {
                Ok(()) => (true, format!("sensor {sensor} of node {} measured and stored", node.get())),
                Err(error) => (false, format!("{error:#}")),
            };
            if let Some(server) = self.tares.get(&(node, sensor)) {
                let sent = server.send_response(id, Response { success, message });
                sent.map_err(|error| anyhow!("cannot answer a call of tare: {error:?}"))?;
            }
            // The mask is another one now.
            self.asked = None;
        }
        Ok(())
    }

    /// A service for each sensor that has come up.
    fn offer(&mut self, topics: &Topics, ros: &mut Middleware) -> Result<()> {
        for (&node, module) in &topics.modules {
            for sensor in 0..module.slip.as_ref().map_or(0, |slip| slip.sensors) {
                if self.tares.contains_key(&(node, sensor)) {
                    continue;
                }
                let service = topics.sensor_topic(node, sensor, "tare");
                let qos = || profile(RELIABLE);
                let kind = ServiceTypeName::new("std_srvs", "Trigger");
                let made = ros.node.create_server(mapping(), &name(&service)?, &kind, qos(), qos());
                let made = made.map_err(|error| anyhow!("service {service}: {error}"))?;
                self.tares.insert((node, sensor), made);
                self.asked = None;
            }
        }
        Ok(())
    }

    fn calls(&self) -> Result<Vec<(NodeId, u8, RmwRequestId)>> {
        let mut calls = Vec::new();
        for (&(node, sensor), server) in &self.tares {
            let call = server.receive_request();
            let call = call.map_err(|error| anyhow!("cannot read a call of tare: {error:?}"))?;
            calls.extend(call.map(|(id, _)| (node, sensor, id)));
        }
        Ok(calls)
    }

    fn tare(
        &mut self,
        node: NodeId,
        sensor: u8,
        source: &mut Source,
        topics: &mut Topics,
        ros: &mut Middleware,
    ) -> Result<()> {
        let client = self.clients.entry(node).or_insert_with(|| Client::new(OWN, node));
        let mut others = |entry: &LogEntry| {
            ensure!(!STOP.load(Ordering::Relaxed), "the node ends");
            topics.entry(entry, ros)
        };
        let mut bus = Bus { source, others: &mut others };
        client.calibrate(&mut bus, sensor, (CALIBRATE, self.tare_seconds.into()), &mut |_| {})
    }
}

/// How the middleware of ROS puts calls into DDS.
fn mapping() -> ServiceMapping {
    match std::env::var("RMW_IMPLEMENTATION") {
        Ok(name) if name.contains("cyclone") => ServiceMapping::Cyclone,
        _ => ServiceMapping::Enhanced,
    }
}
