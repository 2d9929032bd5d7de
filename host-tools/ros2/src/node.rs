//! The node: what is on the bus, published, and a service that tares an array.
//!
//! A topic begins with the first message that belongs to it.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::Result;
use slipsense_recording::decode::Count;
use slipsense_recording::link::{Input, Source, now_us};

use crate::middleware::Middleware;
use crate::services::Services;
use crate::topics::Topics;

pub struct Options {
    /// Before every topic, such as `/slipsense`.
    pub namespace: String,
    pub domain_id: u16,
    /// With a recording: wait so long for a subscriber of the first topic; then its frames come when they came.
    pub wait: Option<Duration>,
    /// How long a service measures an array; `None`: nothing is sent on the bus.
    pub tare_seconds: Option<u8>,
}

#[derive(Debug, serde::Serialize)]
pub struct Published {
    pub messages: u64,
    /// What was on the bus, by node.
    pub nodes: BTreeMap<u8, Count>,
    /// What a recording has and no message says, in words.
    pub notes: Vec<String>,
}

/// Publish what the source says until it ends or `stop` is set.
///
/// # Errors
/// If the source fails, or the middleware.
pub fn run(mut source: Source, options: &Options, stop: &AtomicBool) -> Result<Published> {
    let mut topics = Topics::new(&options.namespace);
    let mut ros = Middleware::new(options.domain_id, options.wait, stop)?;
    let mut services = options.tare_seconds.map(Services::new);
    while !stop.load(Ordering::Relaxed) {
        match source.receive()? {
            Input::Frame(entry) => topics.entry(&entry, &mut ros)?,
            Input::Idle if options.wait.is_none() => topics.tick(now_us(), &mut ros)?,
            Input::Idle | Input::Other(_) => {}
            Input::End => break,
        }
        if let Some(services) = &mut services {
            services.serve(&mut source, &mut topics, &mut ros)?;
        }
    }
    Ok(Published { messages: ros.messages, nodes: topics.decoder.counts(), notes: source.notes() })
}
