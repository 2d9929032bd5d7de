//! What is published, field by field as in `slipsense_msgs/msg` and in ROS' own packages: the order of the fields is
//! the order of the bytes (CDR).

use serde::Serialize;
use slipsense::params::{CLASSES, TAXEL_COLS, TAXEL_ROWS, XL_AXES};
use slipsense::wire::{NodeId, RawMessage, SlipMessage};

pub trait RosMessage: Serialize + Clone + 'static {
    const PACKAGE: &'static str;
    const NAME: &'static str;
    /// Its definition and, marked as ROS' bags do, those of all that it is made of.
    fn definition() -> String;
}

/// `builtin_interfaces/Time`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Time {
    sec: i32,
    nanosec: u32,
}

/// `std_msgs/Header`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Header {
    stamp: Time,
    frame_id: String,
}

impl Header {
    fn new(time_us: u64, frame_id: String) -> Self {
        // Seconds of ROS have 32 bits with a sign; what is beyond stays at the end.
        let sec = i32::try_from(time_us / 1_000_000).unwrap_or(i32::MAX);
        let nanosec = (time_us % 1_000_000) as u32 * 1000;
        Self { stamp: Time { sec, nanosec }, frame_id }
    }
}

/// `slipsense_msgs/SensorContact`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SensorContact {
    health: u8,
    count_sum: u32,
    area: u16,
    centroid_row: f32,
    centroid_col: f32,
    axis_deg: i8,
    elongation: f32,
}

/// `slipsense_msgs/Slip`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Slip {
    header: Header,
    timestamp_us: u64,
    sequence: u32,
    class_index: u8,
    slip: bool,
    may_begin: bool,
    locked: bool,
    invalid: u8,
    degraded: u8,
    starts: u8,
    configuration: u16,
    late_frames: u8,
    logits: [f32; CLASSES],
    log_odds: f32,
    contact: Vec<SensorContact>,
}

impl Slip {
    /// The message that was on the bus at this time, microseconds since 1970.
    pub fn new(node: NodeId, message: &SlipMessage, time_us: u64) -> Self {
        let contact = message.contact.iter().take(message.sensors.into()).map(|contact| SensorContact {
            health: contact.health,
            count_sum: contact.sum,
            area: contact.area,
            centroid_row: contact.centroid_row.to_f64() as f32,
            centroid_col: contact.centroid_col.to_f64() as f32,
            axis_deg: contact.axis_deg,
            elongation: contact.elongation.to_f64() as f32,
        });
        Self {
            header: Header::new(time_us, frame_of(node)),
            timestamp_us: message.timestamp_us,
            sequence: message.sequence,
            class_index: message.class,
            slip: message.slip,
            may_begin: message.may_begin,
            locked: message.locked,
            invalid: message.invalid,
            degraded: message.degraded,
            starts: message.starts,
            configuration: message.configuration,
            late_frames: message.late_frames,
            logits: message.logits.map(|logit| logit.to_f64() as f32),
            log_odds: message.log_odds.to_f64() as f32,
            contact: contact.collect(),
        }
    }
}

/// `slipsense_msgs/Raw`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Raw {
    header: Header,
    timestamp_us: u64,
    sequence: u32,
    sensor: u8,
    health: u8,
    xl_end: u32,
    xl_dropped: u8,
    /// `slipsense_msgs/XlSample`: x, y, z.
    xl: Vec<[i16; XL_AXES]>,
}

impl Raw {
    /// The message that was on the bus at this time, microseconds since 1970.
    pub fn new(node: NodeId, message: &RawMessage, time_us: u64) -> Self {
        Self {
            header: Header::new(time_us, sensor_frame_of(node, message.sensor)),
            timestamp_us: message.timestamp_us,
            sequence: message.sequence,
            sensor: message.sensor,
            health: message.health,
            xl_end: message.xl_end,
            xl_dropped: message.xl_dropped,
            xl: message.xl.to_vec(),
        }
    }
}

/// `sensor_msgs/Image`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Image {
    header: Header,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    data: Vec<u8>,
}

impl Image {
    /// The taxels, 32 × 32 counts as `mono16`.
    pub fn new(node: NodeId, message: &RawMessage, time_us: u64) -> Self {
        let counts = message.piezo.counts().iter();
        Self {
            header: Header::new(time_us, sensor_frame_of(node, message.sensor)),
            height: TAXEL_ROWS as u32,
            width: TAXEL_COLS as u32,
            encoding: "mono16".to_owned(),
            is_bigendian: 0,
            step: 2 * TAXEL_COLS as u32,
            data: counts.flat_map(|count| count.to_le_bytes()).collect(),
        }
    }
}

fn frame_of(node: NodeId) -> String {
    format!("node{}", node.get())
}

fn sensor_frame_of(node: NodeId, sensor: u8) -> String {
    format!("node{}_sensor{sensor}", node.get())
}

/// The topic of a node's slip messages, in the namespace.
pub fn slip_topic(node: NodeId) -> String {
    format!("node{}/slip", node.get())
}

/// The topic of a sensor's raw messages or of its pressure, in the namespace.
pub fn sensor_topic(node: NodeId, sensor: u8, what: &str) -> String {
    format!("node{}/sensor{sensor}/{what}", node.get())
}

const HEADER: (&str, &str) = (
    "std_msgs/Header",
    "builtin_interfaces/Time stamp
string frame_id
",
);
const TIME: (&str, &str) = (
    "builtin_interfaces/Time",
    "int32 sec
uint32 nanosec
",
);
const IMAGE: &str = "std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
";

fn with_parts(definition: &str, parts: &[(&str, &str)]) -> String {
    let mut all = definition.to_owned();
    for (name, definition) in parts {
        all.push_str(&format!("{}\nMSG: {name}\n{definition}", "=".repeat(80)));
    }
    all
}

impl RosMessage for Slip {
    const PACKAGE: &'static str = "slipsense_msgs";
    const NAME: &'static str = "Slip";

    fn definition() -> String {
        let contact =
            ("slipsense_msgs/SensorContact", include_str!("../slipsense_msgs/msg/SensorContact.msg"));
        with_parts(include_str!("../slipsense_msgs/msg/Slip.msg"), &[contact, HEADER, TIME])
    }
}

impl RosMessage for Raw {
    const PACKAGE: &'static str = "slipsense_msgs";
    const NAME: &'static str = "Raw";

    fn definition() -> String {
        let sample = ("slipsense_msgs/XlSample", include_str!("../slipsense_msgs/msg/XlSample.msg"));
        with_parts(include_str!("../slipsense_msgs/msg/Raw.msg"), &[sample, HEADER, TIME])
    }
}

impl RosMessage for Image {
    const PACKAGE: &'static str = "sensor_msgs";
    const NAME: &'static str = "Image";

    fn definition() -> String {
        with_parts(IMAGE, &[HEADER, TIME])
    }
}
