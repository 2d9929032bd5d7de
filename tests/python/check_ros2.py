"""What `slipsense-ros2` makes, read by others.

`log`: the demo's log, in whose middle the module gets a calibration and masked taxels.

`bag`: that log as a bag, by rosbags: every message against `predictions.npz` and the episode; the definitions in the
bag against the files of slipsense_msgs and those of ROS 2 itself, by their hashes (REP 2011).

`node`: the demo published in real time, received by Eclipse Cyclone DDS, the middleware of many ROS 2 systems: every slip
message must arrive. Counts are best effort: what arrives must be right. Then a module of its own is tared.
"""

import os
import pathlib
import signal
import subprocess
import sys
import time

import numpy as np

import fake_module
from checks import Checks

MSGS = pathlib.Path(__file__).resolve().parents[2] / "host-tools" / "ros2" / "slipsense_msgs" / "msg"
NODE = "/slipsense/node42"
LOGIT_SCALE = 256.0
# Not one that a robot in the same network has.
DOMAIN = 117
JOIN_S = 30
SILENCE_S = 5.0
LATE_S = 3.0
DIAGNOSED = ["slipsense: node42", "slipsense: node42_sensor0", "slipsense: node42_sensor1"]
# What the numbers of rmw mean: reliable or best effort, latched or not.
QOS = {"slip": (1, 2), "info": (1, 1), "raw": (2, 2), "counts": (2, 2), "pressure": (2, 2), "diagnostics": (1, 2)}


def check_slip(checks, message, predictions, piezo):
    """A slip message of rosbags or of Cyclone DDS against the command's predictions and the scans."""
    at = f"slip message {message.sequence}"
    checks.decision(message.sequence, message, np.array(message.logits) * LOGIT_SCALE, predictions, piezo)
    checks.equal(f"{at}, sensors", len(message.contact), piezo.shape[1])
    checks.equal(f"{at}, frame", message.header.frame_id, "node42")


def check_definitions(checks, reader):
    """The bag's definitions, by hash, against ROS' own and the package's files."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    standard = set(store.types)
    for path in sorted(MSGS.glob("*.msg")):
        store.register(get_types_from_msg(path.read_text(encoding="utf-8"), f"slipsense_msgs/msg/{path.stem}"))
    kinds = sorted({connection.msgtype for connection in reader.connections})
    ours = [f"slipsense_msgs/msg/{name}" for name in ("Info", "Raw", "Slip")]
    checks.equal("types", kinds, ["diagnostic_msgs/msg/DiagnosticArray", "sensor_msgs/msg/Image", *ours])
    for kind in kinds:
        checks.equal(f"definition of {kind}", reader.typestore.hash_rihs01(kind), store.hash_rihs01(kind))
    return len(kinds), len([kind for kind in kinds if kind in standard])


def kpa(counts):
    """By the nominal film: half of the asymptote at 900 kPa, 4095 at 5 MPa, exponent 0.92."""
    asymptote = 4095 * (1 + (900 / 5000) ** 0.92)
    return 900 * (counts / (asymptote - counts)) ** (1 / 0.92)


def check_pressure(checks, images, scans):
    """kPa of the last frames; not a number off the pad and where taxels are masked."""
    for image, scan in zip(images, scans[len(scans) - len(images) :], strict=True):
        got = np.frombuffer(image.data, "<f4").reshape(32, 32)
        missing = np.isnan(got)
        checks.equal("pressure, shape", (image.height, image.width, image.step, image.encoding), (32, 32, 128, "32FC1"))
        checks.equal("pressure, taxels", int((~missing).sum()), 942 - len(fake_module.MASKED))
        checks.true("pressure, masked taxels", all(missing[at] for at in fake_module.MASKED))
        lost = {tuple(at) for at in np.argwhere(missing & (scan > 0))}
        checks.true("pressure, only masked taxels are missing", lost <= set(fake_module.MASKED))
        checks.true("pressure, kPa", np.allclose(got[~missing], kpa(scan[~missing].astype(float)), rtol=1e-6, atol=0))


def check_diagnostics(checks, arrays, frames):
    """One a second; the last has what the module said in the middle."""
    checks.equal("diagnostics", len(arrays), int((frames - 1) / 240))
    for array in arrays:
        checks.equal("diagnostics, names", [status.name for status in array.status], DIAGNOSED)
    value = [{pair.key: pair.value for pair in status.values} for status in arrays[-1].status]
    checks.equal("diagnostics, levels", [status.level for status in arrays[-1].status], [1, 0, 0])
    checks.equal("diagnostics, rate", abs(int(value[0]["slip messages"]) - 240) <= 1, True)
    checks.equal("diagnostics, module", (value[0]["uptime"], value[0]["status"]), ("7 s", "taxels stuck or saturated"))
    checks.equal("diagnostics, sensor", (value[1]["calibration"], value[1]["masked taxels"]), (fake_module.CALIBRATION, "2"))
    checks.equal("diagnostics, first", {pair.key: pair.value for pair in arrays[0].status[1].values}["calibration"], "not known yet")


def check_bag(checks, bag, predictions, episode):
    """The bag's messages, all of them."""
    from rosbags.highlevel import AnyReader

    predictions, episode = np.load(predictions), np.load(episode)
    piezo, xl, xl_end = episode["piezo"], episode["xl"], episode["xl_end"].astype(np.int64)
    frames, sensors = piezo.shape[:2]
    topics = {name: [] for name in ("/diagnostics", f"{NODE}/slip", f"{NODE}/info", f"{NODE}/sensor0/pressure")}
    topics |= {f"{NODE}/sensor{sensor}/{name}": [] for sensor in range(sensors) for name in ("raw", "counts")}
    with AnyReader([bag]) as reader:
        kinds, standard = check_definitions(checks, reader)
        checks.equal("topics", sorted(reader.topics), sorted(topics))
        for topic in topics:
            offered = reader.topics[topic].connections[0].ext.offered_qos_profiles[0]
            want = QOS[topic.rsplit("/", 1)[1]]
            checks.equal(f"quality of {topic}", (offered.reliability.value, offered.durability.value), want)
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamp = message.header.stamp
            checks.equal(f"time on {connection.topic}", stamp.sec * 10**9 + stamp.nanosec, time_ns)
            topics[connection.topic].append(message)
    slip, info, pressure = (topics[f"{NODE}/{name}"] for name in ("slip", "info", "sensor0/pressure"))
    checks.equal("slip messages", [message.sequence for message in slip], range(frames))
    for message in slip:
        check_slip(checks, message, predictions, piezo)
    samples = 0
    for sensor in range(sensors):
        raw, counts = (topics[f"{NODE}/sensor{sensor}/{name}"] for name in ("raw", "counts"))
        checks.equal(f"raw messages of sensor {sensor}", [message.sequence for message in raw], range(frames))
        for frame, (message, image) in enumerate(zip(raw, counts, strict=True)):
            at = f"frame {frame} of sensor {sensor}"
            end = xl_end[frame, sensor]
            want = xl[sensor, end - len(message.xl) : end]
            checks.equal(f"{at}, xl_end", message.xl_end, end)
            checks.equal(f"{at}, xl", [[s.x, s.y, s.z] for s in message.xl] if message.xl else want[:0], want)
            checks.equal(f"{at}, taxels", np.frombuffer(image.data, "<u2").reshape(32, 32), piezo[frame, sensor])
            checks.equal(f"{at}, shape", (image.height, image.width, image.step, image.encoding), (32, 32, 64, "mono16"))
            samples += len(message.xl)
    checks.equal("pressure begins with the calibration", len(pressure), frames - frames // 2)
    check_pressure(checks, pressure, piezo[:, 0])
    diagnostics = topics["/diagnostics"]
    check_diagnostics(checks, diagnostics, frames)
    said = [(list(message.calibration), list(message.masked_taxels)) for message in info]
    masked = len(fake_module.MASKED)
    checks.equal("info", said, [(["", ""], [0, 0]), ([fake_module.CALIBRATION, ""], [masked, 0])])
    print(
        f"{bag}: {len(slip)} slip messages, {frames * sensors} scans, {len(pressure)} of them in kPa, {samples} accelerometer "
        f"samples and {len(diagnostics)} diagnostics compared, {kinds} definitions ({standard} of them ROS' own): "
        f"{checks.bad} mismatches"
    )


def check_node(checks, program, log, predictions, episode):
    """The node's messages, as another DDS hears them."""
    predictions, piezo = np.load(predictions), np.load(episode)["piezo"]
    import ros2_types as ros
    from cyclonedds.core import Policy
    from cyclonedds.domain import DomainParticipant

    participant, keep = DomainParticipant(DOMAIN), Policy.History.KeepLast(4096)
    slip = ros.reader(participant, f"rt{NODE}/slip", ros.Slip, ros.RELIABLE, keep)
    counts = ros.reader(participant, f"rt{NODE}/sensor0/counts", ros.Image, Policy.Reliability.BestEffort, keep)
    command = [program, "node", log, "--wait", str(JOIN_S), "--domain-id", str(DOMAIN)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as node:
        decisions, images, quiet = [], [], time.monotonic()
        while node.poll() is None or time.monotonic() - quiet < SILENCE_S:
            # What a reader hears when a writer leaves is no message.
            received = [sample for sample in slip.take(N=256) if hasattr(sample, "header")]
            seen = [sample for sample in counts.take(N=256) if hasattr(sample, "header")]
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
    checks.equal("are any counts received", bool(images), True)
    print(
        f"Cyclone DDS: {len(decisions)} of {len(piezo)} slip messages and {len(images)} of {len(piezo)} scans (best "
        f"effort) arrived and were compared: {checks.bad} mismatches"
    )


def check_tare(checks, program, log):
    """A live module: a subscriber that comes late gets `info`; the service tares, by the command of Cyphal."""
    import ros2_types as ros
    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.pub import DataWriter
    from cyclonedds.topic import Topic

    module = fake_module.Module(log)
    module.start()
    command = [program, "node", module.address, "--domain-id", str(DOMAIN), "--tare-seconds", "2"]
    with subprocess.Popen(command, env=os.environ | {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}) as node:
        time.sleep(LATE_S)
        participant = DomainParticipant(DOMAIN)
        info = ros.reader(participant, f"rt{NODE}/info", ros.Info, ros.RELIABLE, Policy.Durability.TransientLocal)
        service = f"{NODE}/sensor0/tare"
        topic = Topic(participant, f"rq{service}Request", ros.TriggerRequest)
        calls = DataWriter(participant, topic, qos=Qos(ros.RELIABLE))
        answers = ros.reader(participant, f"rr{service}Reply", ros.TriggerResponse, ros.RELIABLE)
        time.sleep(LATE_S)
        said = [sample for sample in info.take(N=16) if hasattr(sample, "header")]
        calls.write(ros.TriggerRequest(guid=5, sequence=7, structure_needs_at_least_one_member=0))
        deadline, answered = time.monotonic() + JOIN_S, []
        while not answered and time.monotonic() < deadline:
            answered = [sample for sample in answers.take(N=16) if hasattr(sample, "success")]
            time.sleep(0.05)
        node.send_signal(signal.SIGINT)
    checks.equal("the node's exit code", node.returncode, 0)
    checks.equal("info", [list(message.masked_taxels) for message in said], [[len(fake_module.MASKED), 0]])
    checks.equal("tare", [(sample.guid, sample.sequence, sample.success) for sample in answered], [(5, 7, True)])
    checks.equal("commands to the module", module.commands, [(3, "0 2")])
    print(f"a live module: info for who comes late, tare says {[sample.message for sample in answered]}: {checks.bad} mismatches")


def main():
    """The command line."""
    if sys.argv[1] == "log":
        return fake_module.add_news(*map(pathlib.Path, sys.argv[2:]))
    check = {"bag": check_bag, "node": check_node, "tare": check_tare}[sys.argv[1]]
    np.set_printoptions(threshold=20)
    checks = Checks()
    check(checks, *map(pathlib.Path, sys.argv[2:]))
    return 1 if checks.bad else 0


if __name__ == "__main__":
    sys.exit(main())
