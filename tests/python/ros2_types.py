"""ROS 2 as Cyclone DDS has it: readers, and the messages written a second time, from slipsense_msgs and ROS' own packages."""

from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, float32, int8, int16, int32, int64, sequence, uint8, uint16, uint32, uint64
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))


def reader(participant, topic, kind, *policies):
    return DataReader(participant, Topic(participant, topic, kind), qos=Qos(*policies))


@dataclass
class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
    sec: int32
    nanosec: uint32


@dataclass
class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
    stamp: Time
    frame_id: str


@dataclass
class SensorContact(IdlStruct, typename="slipsense_msgs::msg::dds_::SensorContact_"):
    health: uint8
    count_sum: uint32
    area: uint16
    centroid_row: float32
    centroid_col: float32
    axis_deg: int8
    elongation: float32


@dataclass
class Slip(IdlStruct, typename="slipsense_msgs::msg::dds_::Slip_"):
    header: Header
    timestamp_us: uint64
    sequence: uint32
    class_index: uint8
    slip: bool
    may_begin: bool
    locked: bool
    invalid: uint8
    degraded: uint8
    starts: uint8
    configuration: uint16
    late_frames: uint8
    logits: array[float32, 3]
    log_odds: float32
    contact: sequence[SensorContact, 3]


@dataclass
class Image(IdlStruct, typename="sensor_msgs::msg::dds_::Image_"):
    header: Header
    height: uint32
    width: uint32
    encoding: str
    is_bigendian: uint8
    step: uint32
    data: sequence[uint8]


@dataclass
class Info(IdlStruct, typename="slipsense_msgs::msg::dds_::Info_"):
    header: Header
    frame_rate_hz: float32
    rows: uint16
    cols: uint16
    row_pitch_mm: float32
    col_pitch_mm: float32
    configuration: uint16
    calibration: sequence[str, 3]
    masked_taxels: sequence[int16, 3]


@dataclass
class TriggerRequest(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Request_"):
    """std_srvs/Trigger, as rmw_cyclonedds calls it: a header of its own before the fields."""

    guid: uint64
    sequence: int64
    structure_needs_at_least_one_member: uint8


@dataclass
class TriggerResponse(IdlStruct, typename="std_srvs::srv::dds_::Trigger_Response_"):
    guid: uint64
    sequence: int64
    success: bool
    message: str
