//! Recordings as MCAP: every CAN frame as it came, and beside it what it says, for Foxglove, PlotJuggler and whatever
//! else opens MCAP.
//!
//! | topic | schema (JSON) | what |
//! |---|---|---|
//! | `/can/INTERFACE` | `slipsense.CanFrame` | every frame; all else can be made again from these |
//! | `/node42/slip` | `slipsense.Slip` | flags, class, logits, contact of each sensor |
//! | `/node42/sensor0/raw` | `slipsense.Raw` | number, health, region of the taxels, accelerometer samples |
//! | `/node42/sensor0/pressure` | `foxglove.RawImage` | the array, 32 × 32 counts as `mono16`; 0 outside the region |
//! | `/displacement` | `slipsense.Displacement` | a test stand's crosshead, where there was one |
//!
//! Times are those of the recording, nanoseconds; the module's own clock is in the messages.

use std::collections::{BTreeMap, HashMap};
use std::io::{Read, Seek, Write};

use anyhow::{Context, Result, anyhow, ensure};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use mcap::io::MessageReader;
use mcap::records::MessageHeader;
use mcap::sans_io::LinearReaderOptions;
use mcap::{McapError, Message, WriteOptions, Writer};
use serde_json::{Value, json};
use slipsense::params::{TAXEL_COLS, TAXEL_ROWS};
use slipsense::wire::{CanFrame, NodeId, RawMessage, Received, Region, SlipMessage, WireLogit};

use crate::candump::{Interfaces, LogEntry};
use crate::decode::Decoder;
use crate::recording::Record;

const CAN_TOPIC: &str = "/can/";
const DISPLACEMENT_TOPIC: &str = "/displacement";
// Names of the schemas.
const CAN_FRAME: &str = "slipsense.CanFrame";
const SLIP: &str = "slipsense.Slip";
const RAW: &str = "slipsense.Raw";
/// Foxglove's well-known schema of this name.
const IMAGE: &str = "foxglove.RawImage";
const DISPLACEMENT: &str = "slipsense.Displacement";
/// A chunk is closed when it has this many bytes, about half a second of three sensors.
const CHUNK_BYTES: u64 = 1 << 20;

/// Writes a recording frame by frame. What [`flush`](Self::flush) has written can be read whatever happens later.
pub struct McapSink<W: Write + Seek> {
    writer: Writer<W>,
    channels: HashMap<String, Channel>,
    decoder: Decoder,
}

#[derive(Clone, Copy)]
struct Channel {
    id: u16,
    sequence: u32,
}

impl<W: Write + Seek> McapSink<W> {
    pub fn new(out: W) -> Result<Self> {
        let options = WriteOptions::new()
            .compression(None)
            .chunk_size(Some(CHUNK_BYTES))
            // A chunk is written when it is whole. Else its length is put in afterwards, and of a killed recorder's
            // last chunk nobody knows how long it is.
            .disable_seeking(true)
            .library(concat!("slipsense ", env!("CARGO_PKG_VERSION")));
        Ok(Self { writer: options.create(out)?, channels: HashMap::new(), decoder: Decoder::new() })
    }

    /// Append a frame, and the message that it completes.
    pub fn write(&mut self, entry: &LogEntry) -> Result<()> {
        let time_us = entry.timestamp_us;
        let (id, data) = (entry.frame.id(), STANDARD.encode(entry.frame.data()));
        let topic = format!("{CAN_TOPIC}{}", entry.interface);
        self.put(&topic, CAN_FRAME, time_us, &json!({"id": id, "data": data}))?;
        let Some(decoded) = self.decoder.accept(&entry.frame) else { return Ok(()) };
        let node = decoded.node;
        match decoded.message {
            Received::Slip(message) => {
                self.put(&format!("/node{}/slip", node.get()), SLIP, time_us, &slip_json(&message))
            }
            Received::Raw(message) => self.raw(node, &message, time_us),
        }
    }

    /// Append a position of a test stand's crosshead.
    pub fn displacement(&mut self, time_us: u64, mm: f64) -> Result<()> {
        self.put(DISPLACEMENT_TOPIC, DISPLACEMENT, time_us, &json!({"displacement_mm": mm}))
    }

    /// Close the chunk and write everything out.
    pub fn flush(&mut self) -> Result<()> {
        Ok(self.writer.flush()?)
    }

    /// Write index and end.
    pub fn finish(mut self) -> Result<W> {
        self.writer.finish()?;
        Ok(self.writer.into_inner())
    }

    fn raw(&mut self, node: NodeId, message: &RawMessage, time_us: u64) -> Result<()> {
        let sensor = format!("/node{}/sensor{}", node.get(), message.sensor);
        let region = message.known();
        let value = json!({
            "timestamp_us": message.timestamp_us, "sequence": message.sequence, "sensor": message.sensor,
            "health": message.health, "xl_end": message.xl_end, "xl_dropped": message.xl_dropped,
            "xl": message.xl.as_slice(), "region": region.to_bytes(),
        });
        self.put(&format!("{sensor}/raw"), RAW, time_us, &value)?;
        if region == Region::NONE {
            return Ok(());
        }
        let counts = message.piezo.counts().iter();
        let bytes: Vec<u8> = counts.flat_map(|count| count.to_le_bytes()).collect();
        let image = json!({
            "timestamp": {"sec": time_us / 1_000_000, "nsec": time_us % 1_000_000 * 1000},
            "frame_id": format!("node{}_sensor{}", node.get(), message.sensor),
            "width": TAXEL_COLS, "height": TAXEL_ROWS, "encoding": "mono16", "step": 2 * TAXEL_COLS,
            "data": STANDARD.encode(bytes),
        });
        self.put(&format!("{sensor}/pressure"), IMAGE, time_us, &image)
    }

    fn put(&mut self, topic: &str, kind: &str, time_us: u64, value: &Value) -> Result<()> {
        let channel = match self.channels.get_mut(topic) {
            Some(channel) => channel,
            None => {
                let mut schema = schema(value);
                schema["title"] = kind.into();
                let schema = self.writer.add_schema(kind, "jsonschema", schema.to_string().as_bytes())?;
                let id = self.writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
                self.channels.entry(topic.to_owned()).or_insert(Channel { id, sequence: 0 })
            }
        };
        let log_time = time_us.checked_mul(1000).context("time beyond the year 2554")?;
        let Channel { id: channel_id, sequence } = *channel;
        channel.sequence = sequence.wrapping_add(1);
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        Ok(self.writer.write_to_known_channel(&header, value.to_string().as_bytes())?)
    }
}

/// A slip message as JSON, by the names of its DSDL definition.
fn slip_json(message: &SlipMessage) -> Value {
    let contact = message.contact.iter().take(message.sensors.into());
    let contact = contact.map(|contact| {
        json!({
            "health": contact.health, "count_sum": contact.sum, "area": contact.area,
            "centroid_row": contact.centroid_row.to_f64(),
            "centroid_col": contact.centroid_col.to_f64(),
            "axis_deg": contact.axis_deg, "elongation": contact.elongation.to_f64(),
        })
    });
    json!({
        "timestamp_us": message.timestamp_us, "sequence": message.sequence, "class_index": message.class,
        "slip": message.slip, "may_begin": message.may_begin, "locked": message.locked,
        "invalid": message.invalid, "degraded": message.degraded, "starts": message.starts,
        "configuration": message.configuration, "late_frames": message.late_frames,
        "logits": message.logits.map(WireLogit::to_f64), "log_odds": message.log_odds.to_f64(),
         "contact": contact.collect::<Vec<_>>(),
    })
}

/// JSON schema of messages such as this one; an array's items are as its first.
fn schema(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let of_field = |(name, value): (&String, &Value)| match name.as_str() {
                "data" => (name.clone(), json!({"type": "string", "contentEncoding": "base64"})),
                _ => (name.clone(), schema(value)),
            };
            let properties: serde_json::Map<_, _> = fields.iter().map(of_field).collect();
            let required: Vec<_> = fields.keys().collect();
            let mut object = json!({"type": "object", "properties": properties, "required": required});
            if fields.contains_key("nsec") {
                // What Foxglove knows a time by.
                object["title"] = "time".into();
            }
            object
        }
        Value::Array(items) => match items.first() {
            Some(first) => json!({"type": "array", "items": schema(first)}),
            None => json!({"type": "array"}),
        },
        Value::Number(number) if number.is_f64() => json!({"type": "number"}),
        Value::Number(_) => json!({"type": "integer"}),
        Value::Bool(_) => json!({"type": "boolean"}),
        Value::String(_) => json!({"type": "string"}),
        Value::Null => json!({"type": "null"}),
    }
}

/// `/node42/sensor0/pressure`, with any numbers.
fn is_pressure(topic: &str) -> bool {
    let numbers = topic.strip_prefix("/node").and_then(|rest| rest.strip_suffix("/pressure"));
    let numbers = numbers.and_then(|numbers| numbers.split_once("/sensor"));
    numbers.is_some_and(|(node, sensor)| node.parse::<u8>().is_ok() && sensor.parse::<u8>().is_ok())
}

/// Of an error that draws a picture of where it was, as those of a record's bytes do, the line that says what.
fn one_line(error: &McapError) -> String {
    let text = error.to_string();
    let what = text.lines().find_map(|line| line.split_once("Error: "));
    let what = what.map_or(text.lines().next().unwrap_or_default(), |(_, what)| what);
    let colours = ["\u{1b}[1m", "\u{1b}[22m"];
    colours.iter().fold(what.to_owned(), |plain, colour| plain.replace(colour, ""))
}

/// Reads a recording entry by entry, also one that was cut short when its recorder was killed. An error is its end.
pub struct McapSource<R: Read> {
    messages: MessageReader<R>,
    /// Messages so far.
    index: u64,
    /// Messages of other topics, by topic.
    skipped: BTreeMap<String, u64>,
    interfaces: Interfaces,
    cut_short: bool,
}

impl<R: Read> McapSource<R> {
    /// Of a file of `length` bytes: no record of it is longer.
    pub fn new(input: R, length: u64) -> Self {
        let limit = usize::try_from(length).unwrap_or(usize::MAX);
        let options = LinearReaderOptions::default().with_record_length_limit(limit);
        let messages = MessageReader::new_with_options(input, options);
        let (skipped, interfaces) = (BTreeMap::new(), Interfaces::default());
        Self { messages, index: 0, skipped, interfaces, cut_short: false }
    }

    /// What is left out so far, in words.
    pub fn notes(&self) -> Vec<String> {
        let cut = self.cut_short.then(|| "the file was cut short; everything up to there is read".to_owned());
        let skipped = self.skipped.iter();
        let skipped = skipped.map(|(topic, count)| format!("{count} messages of {topic} are left out"));
        cut.into_iter().chain(skipped).collect()
    }

    /// The entry that a message is; `None` if it says again what CAN frames say, or is of another topic.
    fn entry(&mut self, index: u64, message: &Message<'_>) -> Result<Option<Record>> {
        // Whatever stands in a topic, an error stays one line.
        let topic = message.channel.topic.escape_debug().to_string();
        let at = || format!("message {index} of {topic}");
        let value =
            || serde_json::from_slice::<Value>(&message.data).with_context(|| format!("{}: not JSON", at()));
        let schema = message.channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
        let timestamp_us = message.log_time / 1000;
        let interface = message.channel.topic.strip_prefix(CAN_TOPIC);
        if let Some(interface) = interface.filter(|_| schema == CAN_FRAME) {
            let in_name = |c: char| !c.is_whitespace() && !c.is_control();
            let is_name = !interface.is_empty() && interface.chars().all(in_name);
            ensure!(is_name, "{}: an interface needs a name without white space", at());
            let frame = can_frame(&value()?).with_context(at)?;
            ensure!(message.log_time.is_multiple_of(1000), "{}: time is no whole microsecond", at());
            let entry = LogEntry { timestamp_us, interface: interface.to_owned(), frame };
            self.interfaces.check(&entry).with_context(at)?;
            return Ok(Some(Record::Frame(entry)));
        }
        if schema == DISPLACEMENT {
            let mm = value()?["displacement_mm"].as_f64();
            let mm = mm.with_context(|| format!("{}: `displacement_mm` must be a number", at()))?;
            return Ok(Some(Record::Displacement { timestamp_us, mm }));
        }
        let ours = match schema {
            SLIP | RAW => true,
            // Others use Foxglove's schema as well.
            IMAGE => is_pressure(&message.channel.topic),
            _ => false,
        };
        if !ours {
            *self.skipped.entry(topic).or_default() += 1;
        }
        Ok(None)
    }
}

impl<R: Read> Iterator for McapSource<R> {
    type Item = Result<Record>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let (index, message) = (self.index, self.messages.next());
            self.index += 1;
            let next = match message {
                Some(Ok(message)) => self.entry(index, &message),
                None => return None,
                Some(Err(McapError::UnexpectedEof)) if index > 0 => {
                    self.cut_short = true;
                    return None;
                }
                Some(Err(error @ McapError::BadMagic)) => {
                    Err(anyhow!("not an MCAP file: {}", one_line(&error)))
                }
                Some(Err(error)) => Err(anyhow!("after message {index}: {}", one_line(&error))),
            };
            if let Some(record) = next.transpose() {
                return Some(record);
            }
        }
    }
}

fn can_frame(value: &Value) -> Result<CanFrame> {
    let id =
        value["id"].as_u64().and_then(|id| u32::try_from(id).ok()).context("`id` must be an identifier")?;
    let data = value["data"].as_str().and_then(|data| STANDARD.decode(data).ok());
    Ok(CanFrame::new(id, &data.context("`data` must be base64")?)?)
}
