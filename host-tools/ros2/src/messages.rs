//! What is published, field by field as in `slipsense_msgs/msg` and in ROS' own packages: the order of the fields is
//! the order of the bytes (CDR).

use serde::Serialize;
use slipsense::params::{
    CLASSES, COL_PITCH_MM, FRAME_RATE_HZ, ROW_PITCH_MM, TAXEL_COLS, TAXEL_ROWS, TAXELS, XL_AXES,
};
use slipsense::sensor::TaxelMask;
use slipsense::wire::{NodeId, RawMessage, SlipMessage};
use slipsense_recording::film::PRESSURE_KPA;

/// How a topic is offered.
#[derive(Clone, Copy)]
pub struct Qos {
    /// Lost messages are sent again; else a subscriber must be content with best effort, as RViz is.
    pub reliable: bool,
    /// A subscriber that comes late gets the last one.
    pub latched: bool,
    /// Messages that wait for a slow subscriber; then the oldest goes.
    pub depth: u32,
}

/// Package and name.
type Kind = (&'static str, &'static str);
/// Name and text.
type Definition = (&'static str, &'static str);

pub trait RosMessage: Serialize + Clone + 'static {
    const KIND: Kind;
    const QOS: Qos;
    const DEFINITION: &'static str;
    /// Of all that it is made of, beside the header.
    const PARTS: &'static [Definition] = &[];

    /// Its definition and, marked as ROS' bags do, those of its parts.
    fn definition() -> String {
        let part = |(name, part): &(_, _)| format!("{}\nMSG: {name}\n{part}", "=".repeat(80));
        let header = [("std_msgs/Header", HEADER), ("builtin_interfaces/Time", TIME)];
        Self::DEFINITION.to_owned() + &Self::PARTS.iter().chain(&header).map(part).collect::<String>()
    }
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
    pub fn new(time_us: u64, frame_id: String) -> Self {
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
    fn new(node: NodeId, message: &RawMessage, time_us: u64, encoding: &str, data: Vec<u8>) -> Self {
        Self {
            header: Header::new(time_us, sensor_frame_of(node, message.sensor)),
            height: TAXEL_ROWS as u32,
            width: TAXEL_COLS as u32,
            encoding: encoding.to_owned(),
            is_bigendian: 0,
            step: (data.len() / TAXEL_ROWS) as u32,
            data,
        }
    }

    /// The taxels, 32 × 32 counts as `mono16`; 0 where there is none, or it was not sent.
    pub fn counts(node: NodeId, message: &RawMessage, time_us: u64) -> Self {
        let counts = message.piezo.counts().iter();
        Self::new(node, message, time_us, "mono16", counts.flat_map(|count| count.to_le_bytes()).collect())
    }

    /// The taxels, 32 × 32 kPa as `32FC1`; not a number where there is no taxel, a masked one, or one that was not sent.
    pub fn pressure(node: NodeId, message: &RawMessage, mask: &TaxelMask, time_us: u64) -> Self {
        let region = message.known();
        let kpa = (0..TAXELS).zip(message.piezo.counts()).map(|(at, &count)| {
            let (row, col) = (at / TAXEL_COLS, at % TAXEL_COLS);
            let is_read = region.cols(row).contains(&col) && !mask.masks(row, col);
            if is_read { PRESSURE_KPA[usize::from(count)] } else { f32::NAN }
        });
        Self::new(node, message, time_us, "32FC1", kpa.flat_map(f32::to_le_bytes).collect())
    }
}

/// `slipsense_msgs/Info`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Info {
    header: Header,
    frame_rate_hz: f32,
    rows: u16,
    cols: u16,
    row_pitch_mm: f32,
    col_pitch_mm: f32,
    configuration: u16,
    calibration: Vec<String>,
    masked_taxels: Vec<i16>,
}

impl Info {
    /// `sensors`: of each, its calibration, and how many taxels are masked; empty and −1 where that is not known.
    pub fn new(node: NodeId, configuration: u16, sensors: Vec<(String, i16)>, time_us: u64) -> Self {
        let (calibration, masked_taxels) = sensors.into_iter().unzip();
        Self {
            header: Header::new(time_us, frame_of(node)),
            frame_rate_hz: FRAME_RATE_HZ as f32,
            rows: TAXEL_ROWS as u16,
            cols: TAXEL_COLS as u16,
            row_pitch_mm: ROW_PITCH_MM,
            col_pitch_mm: COL_PITCH_MM,
            configuration,
            calibration,
            masked_taxels,
        }
    }
}

/// `diagnostic_msgs/KeyValue`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct KeyValue {
    pub key: String,
    pub value: String,
}

/// `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DiagnosticStatus {
    /// 0 well, 1 warning, 2 error, 3 stale.
    pub level: u8,
    pub name: String,
    pub message: String,
    pub hardware_id: String,
    pub values: Vec<KeyValue>,
}

/// `diagnostic_msgs/DiagnosticArray`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DiagnosticArray {
    pub header: Header,
    pub status: Vec<DiagnosticStatus>,
}

pub fn frame_of(node: NodeId) -> String {
    format!("node{}", node.get())
}

pub fn sensor_frame_of(node: NodeId, sensor: u8) -> String {
    format!("node{}_sensor{sensor}", node.get())
}

const IMAGE: &str = "std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
";
const DIAGNOSTICS: &str = "std_msgs/Header header\ndiagnostic_msgs/DiagnosticStatus[] status\n";
const STATUS: &str = "byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
";
const KEY_VALUE: &str = "string key\nstring value\n";
const HEADER: &str = "builtin_interfaces/Time stamp\nstring frame_id\n";
const TIME: &str = "int32 sec\nuint32 nanosec\n";
/// For what is looked at and recorded: newest first, none twice.
const SENSOR_DATA: Qos = Qos { reliable: false, latched: false, depth: 5 };
pub const RELIABLE: Qos = Qos { reliable: true, latched: false, depth: 10 };

impl RosMessage for Slip {
    const KIND: Kind = ("slipsense_msgs", "Slip");
    const QOS: Qos = RELIABLE;
    const DEFINITION: &'static str = include_str!("../slipsense_msgs/msg/Slip.msg");
    const PARTS: &'static [Definition] =
        &[("slipsense_msgs/SensorContact", include_str!("../slipsense_msgs/msg/SensorContact.msg"))];
}

impl RosMessage for Raw {
    const KIND: Kind = ("slipsense_msgs", "Raw");
    const QOS: Qos = SENSOR_DATA;
    const DEFINITION: &'static str = include_str!("../slipsense_msgs/msg/Raw.msg");
    const PARTS: &'static [Definition] =
        &[("slipsense_msgs/XlSample", include_str!("../slipsense_msgs/msg/XlSample.msg"))];
}

impl RosMessage for Image {
    const KIND: Kind = ("sensor_msgs", "Image");
    const QOS: Qos = SENSOR_DATA;
    const DEFINITION: &'static str = IMAGE;
}

impl RosMessage for Info {
    const KIND: Kind = ("slipsense_msgs", "Info");
    const QOS: Qos = Qos { reliable: true, latched: true, depth: 1 };
    const DEFINITION: &'static str = include_str!("../slipsense_msgs/msg/Info.msg");
}

impl RosMessage for DiagnosticArray {
    const KIND: Kind = ("diagnostic_msgs", "DiagnosticArray");
    const QOS: Qos = RELIABLE;
    const DEFINITION: &'static str = DIAGNOSTICS;
    const PARTS: &'static [Definition] =
        &[("diagnostic_msgs/DiagnosticStatus", STATUS), ("diagnostic_msgs/KeyValue", KEY_VALUE)];
}
