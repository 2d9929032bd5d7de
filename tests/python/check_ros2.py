#!/usr/bin/env python3
"""What `slipsense-ros2` makes, read by others.

`bag`: the demo as a bag, by rosbags: every message against `predictions.npz` and the episode; the definitions in the
bag against the files of slipsense_msgs and those of ROS 2 itself, by their hashes (REP 2011).

`node`: the demo published in real time, received by Eclipse Cyclone DDS, the middleware of many ROS 2 systems: every slip
message must arrive. Pressure is best effort: what arrives must be right.
"""

import pathlib
import subprocess
import sys
import time

import numpy as np

from checks import Checks

MSGS = pathlib.Path(__file__).resolve().parents[2] / "host-tools" / "ros2" / "slipsense_msgs" / "msg"
NODE = "/slipsense/node42"
LOGIT_SCALE = 256.0
# Not one that a robot in the same network has.
DOMAIN = 117
JOIN_S = 30
SILENCE_S = 5.0


def check_slip(checks, message, predictions, piezo):
    """A slip message of rosbags or of Cyclone DDS against the command's predictions and the scans."""
    index = message.sequence
    at = f"slip message {index}"
    checks.equal(f"{at}, class", message.class_index, predictions["class"][index])
    checks.equal(f"{at}, logits", np.array(message.logits) * LOGIT_SCALE, ((predictions["logits"][index] + 2) >> 2).clip(-32768, 32767))
    for flag in ("slip", "may_begin"):
        checks.equal(f"{at}, {flag}", int(getattr(message, flag)), predictions[flag][index])
    sums = [contact.count_sum for contact in message.contact]
    checks.equal(f"{at}, sums", sums, piezo[index].sum(axis=(1, 2), dtype=np.uint32))
    checks.equal(f"{at}, frame", message.header.frame_id, "node42")


def check_definitions(checks, reader):
    """The bag's definitions, by hash, against ROS' own and the package's files."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    standard = set(store.types)
    for path in sorted(MSGS.glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"slipsense_msgs/msg/{path.stem}"))
    kinds = sorted({connection.msgtype for connection in reader.connections})
    checks.equal("types", kinds, ["sensor_msgs/msg/Image", "slipsense_msgs/msg/Raw", "slipsense_msgs/msg/Slip"])
    for kind in kinds:
        checks.equal(f"definition of {kind}", reader.typestore.hash_rihs01(kind), store.hash_rihs01(kind))
    return len(kinds), len([kind for kind in kinds if kind in standard])


def check_bag(checks, bag, predictions, episode):
    """The bag's messages, all of them."""
    from rosbags.highlevel import AnyReader

    predictions, episode = np.load(predictions), np.load(episode)
    piezo, xl, xl_end = episode["piezo"], episode["xl"], episode["xl_end"].astype(np.int64)
    frames, sensors = piezo.shape[:2]
    slip, raw, pressure = [], [[] for _ in range(sensors)], [[] for _ in range(sensors)]
    with AnyReader([bag]) as reader:
        kinds, standard = check_definitions(checks, reader)
        topics = {f"{NODE}/slip": slip}
        for sensor in range(sensors):
            topics[f"{NODE}/sensor{sensor}/raw"] = raw[sensor]
            topics[f"{NODE}/sensor{sensor}/pressure"] = pressure[sensor]
        checks.equal("topics", sorted(reader.topics), sorted(topics))
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            checks.equal(f"time on {connection.topic}", stamp.sec * 10**9 + stamp.nanosec, time_ns)
            topics[connection.topic].append(message)
        checks.equal("messages", reader.message_count, frames * (1 + 2 * sensors))
    checks.equal("slip messages", [message.sequence for message in slip], range(frames))
    for message in slip:
        check_slip(checks, message, predictions, piezo)
    samples = 0
    for sensor in range(sensors):
        checks.equal(f"raw messages of sensor {sensor}", [message.sequence for message in raw[sensor]], range(frames))
        for frame, (message, image) in enumerate(zip(raw[sensor], pressure[sensor], strict=True)):
            at = f"frame {frame} of sensor {sensor}"
            end = xl_end[frame, sensor]
            want = xl[sensor, end - len(message.xl) : end]
            checks.equal(f"{at}, xl_end", message.xl_end, end)
            checks.equal(f"{at}, xl", [[s.x, s.y, s.z] for s in message.xl] if message.xl else want[:0], want)
            checks.equal(f"{at}, taxels", np.frombuffer(image.data, "<u2").reshape(32, 32), piezo[frame, sensor])
            checks.equal(f"{at}, shape", (image.height, image.width, image.step, image.encoding), (32, 32, 64, "mono16"))
            samples += len(message.xl)
    print(
        f"{bag}: {len(slip)} slip messages, {frames * sensors} scans and {samples} accelerometer samples "
        f"compared, {kinds} definitions ({standard} of them ROS' own): {checks.bad} mismatches"
    )


def readers():
    """Cyclone DDS on the topics of slip and of the first sensor's pressure."""
    import ros2_types
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration

    participant = DomainParticipant(DOMAIN)
    keep = Policy.History.KeepLast(4096)
    reliable = Qos(Policy.Reliability.Reliable(duration(seconds=1)), keep)
    slip = DataReader(participant, Topic(participant, f"rt{NODE}/slip", ros2_types.Slip), qos=reliable)
    effort = Qos(Policy.Reliability.BestEffort, keep)
    topic = Topic(participant, f"rt{NODE}/sensor0/pressure", ros2_types.Image)
    return slip, DataReader(participant, topic, qos=effort)


def check_node(checks, program, log, predictions, episode):
    """The node's messages, as another DDS hears them."""
    predictions, piezo = np.load(predictions), np.load(episode)["piezo"]
    slip, pressure = readers()
    command = [program, "node", log, "--wait", str(JOIN_S), "--domain-id", str(DOMAIN)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as node:
        decisions, images, quiet = [], [], time.monotonic()
        while node.poll() is None or time.monotonic() - quiet < SILENCE_S:
            # What a reader hears when a writer leaves is no message.
            received = [sample for sample in slip.take(N=256) if hasattr(sample, "header")]
            seen = [sample for sample in pressure.take(N=256) if hasattr(sample, "header")]
            decisions += received
            images += seen
            if received or seen:
                quiet = time.monotonic()
            time.sleep(0.002)
        print(node.stdout.read(), end="")
    checks.equal("the node's exit code", node.returncode, 0)
    checks.equal("slip messages that arrived", [message.sequence for message in decisions], range(len(piezo)))
    for message in decisions:
        check_slip(checks, message, predictions, piezo)
    # A scan's number is in the raw message beside it; here its place in time tells.
    stamps = {(m.header.stamp.sec, m.header.stamp.nanosec): m.sequence for m in decisions}
    order = sorted(stamps)
    for image in images:
        at = (image.header.stamp.sec, image.header.stamp.nanosec)
        sequence = stamps[max(stamp for stamp in order if stamp <= at)]
        scan = np.frombuffer(bytes(image.data), "<u2").reshape(32, 32)
        checks.equal(f"taxels of frame {sequence}", scan, piezo[sequence, 0])
    checks.equal("is any pressure received", bool(images), True)
    print(
        f"Cyclone DDS: {len(decisions)} of {len(piezo)} slip messages and {len(images)} of {len(piezo)} scans (best "
        f"effort) arrived and were compared: {checks.bad} mismatches"
    )


def main():
    """The command line."""
    check = {"bag": check_bag, "node": check_node}[sys.argv[1]]
    np.set_printoptions(threshold=20)
    checks = Checks()
    check(checks, *map(pathlib.Path, sys.argv[2:]))
    return 1 if checks.bad else 0


if __name__ == "__main__":
    sys.exit(main())
