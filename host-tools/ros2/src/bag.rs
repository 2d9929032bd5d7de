//! A recording of the bus as a bag of ROS 2: a folder with an MCAP file, as `rosbag2` keeps it, and its `metadata.yaml`.
//!
//! Topics are those of the node; the CAN frames themselves are not in it: the recording has them.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use cdr_encoding::to_vec;
use mcap::records::MessageHeader;
use mcap::{WriteOptions, Writer};
use serde_json::json;
use slipsense_recording::decode::Count;
use slipsense_recording::log_file::{self, Format, Record};

use crate::messages::{Qos, RosMessage};
use crate::topics::{Sink, Topics, namespace};

/// CDR, low byte first, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];
/// A chunk is closed when it has this many bytes.
const CHUNK_BYTES: u64 = 1 << 20;
/// What `metadata.yaml` is written by: rosbag2's format with which Humble came.
const METADATA_VERSION: u32 = 5;
const BAG_FILE: &str = "bag_0.mcap";

/// Write a recording of the bus as a bag of ROS 2, in MCAP
///
/// The bag has the node's topics and can be played, plotted and converted by what ROS 2 has. The CAN frames stay in
/// the recording.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  slipsense-ros2 bag grasp.mcap grasp_bag
  ros2 bag play grasp_bag")]
pub struct Args {
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

#[derive(serde::Serialize)]
struct Written {
    messages: BTreeMap<String, u64>,
    /// What was on the bus, by node.
    nodes: BTreeMap<u8, Count>,
    /// What the recording has and no message says, in words.
    notes: Vec<String>,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let Some(format) = Format::from_path(&self.recording) else {
            bail!("{}: must end in .mcap or .log", self.recording.display())
        };
        let written = write(&self.out, &self.recording, format, &self.namespace)?;
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

/// Write a bag of a recording into the new folder `out`, with all topics in `namespace`. What fails leaves nothing behind.
fn write(out: &Path, recording: &Path, format: Format, namespace: &str) -> Result<Written> {
    ensure!(!out.exists(), "{}: is there already; a bag is a new folder", out.display());
    let parent = out.parent().filter(|parent| *parent != Path::new("")).unwrap_or(Path::new("."));
    let made = tempfile::Builder::new().prefix(".slipsense-").suffix(".partial").tempdir_in(parent);
    let partial = made.with_context(|| format!("{}: cannot write", parent.display()))?;
    let file = File::create(partial.path().join(BAG_FILE))?;
    let (mut bag, mut topics) = (Bag::new(file)?, Topics::new(namespace));
    let mut reader = log_file::open(recording, format)?;
    for record in reader.by_ref() {
        if let Record::Frame(entry) = record? {
            topics.entry(&entry, &mut bag)?;
        }
    }
    let (mut written, metadata) =
        bag.finish(topics.decoder.counts()).with_context(|| recording.display().to_string())?;
    written.notes = reader.notes();
    std::fs::write(partial.path().join("metadata.yaml"), metadata)?;
    let kept = partial.keep();
    std::fs::rename(&kept, out).with_context(|| format!("{}: cannot write", out.display()))?;
    Ok(written)
}

struct Topic {
    channel: u16,
    kind: String,
    /// As `rosbag2` writes it.
    qos: String,
    messages: u64,
}

struct Bag {
    writer: Writer<BufWriter<File>>,
    topics: BTreeMap<String, Topic>,
    /// Nanoseconds of the first and last message.
    span: Option<(u64, u64)>,
}

impl Bag {
    fn new(file: File) -> Result<Self> {
        let options = WriteOptions::new()
            .profile("ros2")
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            .library(concat!("slipsense ", env!("CARGO_PKG_VERSION")));
        Ok(Self { writer: options.create(BufWriter::new(file))?, topics: BTreeMap::new(), span: None })
    }

    fn finish(mut self, nodes: BTreeMap<u8, Count>) -> Result<(Written, String)> {
        let Some((first, last)) = self.span else { bail!("no slip or raw message in the recording") };
        self.writer.finish()?;
        self.writer.into_inner().flush()?;
        let total: u64 = self.topics.values().map(|topic| topic.messages).sum();
        let topics = self.topics.iter().map(|(name, topic)| {
            json!({
                "topic_metadata": {
                    "name": name, "type": topic.kind, "serialization_format": "cdr",
                    "offered_qos_profiles": topic.qos,
                },
                "message_count": topic.messages,
            })
        });
        let span = |nanoseconds: u64| json!({"nanoseconds": nanoseconds});
        let since = json!({"nanoseconds_since_epoch": first});
        // What is JSON is YAML.
        let metadata = json!({"rosbag2_bagfile_information": {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": span(last - first),
            "starting_time": since,
            "message_count": total,
            "topics_with_message_count": topics.collect::<Vec<_>>(),
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [BAG_FILE],
            "files": [{
                "path": BAG_FILE, "starting_time": since, "duration": span(last - first), "message_count": total,
            }],
        }});
        let messages = self.topics.into_iter().map(|(name, topic)| (name, topic.messages)).collect();
        let written = Written { messages, nodes, notes: Vec::new() };
        Ok((written, serde_json::to_string_pretty(&metadata)? + "\n"))
    }
}

impl Sink for Bag {
    fn put<M: RosMessage>(&mut self, name: &str, message: M, time_us: u64) -> Result<()> {
        let topic = match self.topics.get_mut(name) {
            Some(topic) => topic,
            None => {
                let kind = format!("{}/msg/{}", M::KIND.0, M::KIND.1);
                let schema = self.writer.add_schema(&kind, "ros2msg", M::definition().as_bytes())?;
                let qos = profiles(M::QOS);
                let metadata = BTreeMap::from([("offered_qos_profiles".to_owned(), qos.clone())]);
                let channel = self.writer.add_channel(schema, name, "cdr", &metadata)?;
                self.topics.entry(name.to_owned()).or_insert(Topic { channel, kind, qos, messages: 0 })
            }
        };
        let log_time = time_us.checked_mul(1000).context("time beyond the year 2554")?;
        let (channel_id, sequence) = (topic.channel, topic.messages as u32);
        topic.messages += 1;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        let mut bytes = ENCAPSULATION.to_vec();
        bytes.extend(to_vec::<M, byteorder::LittleEndian>(&message)?);
        self.writer.write_to_known_channel(&header, &bytes)?;
        let (first, last) = self.span.unwrap_or((log_time, log_time));
        self.span = Some((first.min(log_time), last.max(log_time)));
        Ok(())
    }
}

/// With what `ros2 bag play` offers a topic again: YAML, which JSON is, with the numbers of `rmw`.
fn profiles(qos: Qos) -> String {
    let forever = json!({"sec": i32::MAX, "nsec": 999_999_999});
    json!([{
        "history": 1, "depth": qos.depth,
        "reliability": if qos.reliable { 1 } else { 2 },
        "durability": if qos.latched { 1 } else { 2 },
        "deadline": forever, "lifespan": forever, "liveliness": 1, "liveliness_lease_duration": forever,
        "avoid_ros_namespace_conventions": false,
    }])
    .to_string()
}
