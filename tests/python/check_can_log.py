"""Check a CAN log against the predictions and the episode it was made from, with pycyphal.

  check_can_log.py CAN_LOG PREDICTIONS.npz EPISODE.npz

Nothing here comes from this project but the DSDL definitions, and the frequencies of the compression:
pycyphal compiles the definitions, replays the log in real time through its CAN transport and decodes
every transfer; compressed data are decoded by compressed.py. A log holds plain or compressed raw frames. Each slip message must equal its row
of the predictions; from the raw frames, counts, accelerometer samples and xl_end of the episode must
come out again. Any mismatch, lost transfer or transport error is printed; the exit status is then 1.
"""

import asyncio
import collections
import logging
import pathlib
import re
import sys
import tempfile
import warnings

import numpy as np

# One of pycyphal's dependencies warns about another on Python 3.11.
warnings.filterwarnings("ignore", category=DeprecationWarning)

import compressed
from checks import Checks
import pycyphal.dsdl
from pycyphal.presentation import Presentation
from pycyphal.transport.can import CANTransport
from pycyphal.transport.can.media.candump import CandumpMedia

DSDL = pathlib.Path(__file__).resolve().parents[2] / "src" / "wire" / "dsdl" / "slipsense"
LINE = re.compile(r"\(\d+\.\d{6}\) \w+ ([0-9A-F]{8})##1(?:[0-9A-F]{2})*([0-9A-F]{2})\n")
SLIP_PORT, RAW_PORT, COMPRESSED_PORT = 6203, 6201, 6202
RAW_XL_MAX = 64
SILENCE_S = 10.0
# Cells cut from either end of each row, as the comment of Raw.1.0.dsdl gives them.
ROW_CUT = [5, 5, 4, 4, 2] + [0] * 22 + [2, 4, 5, 5, 5]
ACTIVE = np.array([[cut <= col < 32 - cut for col in range(32)] for cut in ROW_CUT])


def scan_log(path, sensors, checks):
    """Order and number of transfers as the lines show them: each period opens with one slip message,
    the raw transfers of all sensors follow. Returns frames, slip messages, raw transfers and compressed ones."""
    frames = 0
    started = collections.Counter()
    open_raw = None
    with open(path, encoding="ascii") as log:
        for number, line in enumerate(log, 1):
            match = LINE.fullmatch(line)
            checks.true(f"{path}: line {number} is not a CAN FD frame: {line!r}", match)
            if not match:
                continue
            frames += 1
            port, tail = int(match[1], 16) >> 8 & 0x1FFF, int(match[2], 16)
            started[port] += tail >> 7
            if port == SLIP_PORT:
                checks.true(f"line {number}: {open_raw} raw transfers, need {sensors}", open_raw in (None, sensors))
                open_raw = 0
            else:
                checks.true(f"line {number}: a raw frame before the first slip message", open_raw is not None)
                open_raw = (open_raw or 0) + (tail >> 7)
    return frames, started[SLIP_PORT], started[RAW_PORT], started[COMPRESSED_PORT]


async def receive(path, types, count):
    """Replay the log; returns the transfers of each type with their messages, and pycyphal's counters."""
    transport = CANTransport(CandumpMedia(path), local_node_id=None)
    presentation = Presentation(transport)
    # Both before the first await: the replay starts with the first of them.
    subscribers = [presentation.make_subscriber_with_fixed_subject_id(dtype) for dtype in types]
    received = []
    for subscriber, want in zip(subscribers, count):
        messages = []
        while len(messages) < want:
            item = await subscriber.receive_for(SILENCE_S)
            if item is None:
                break
            messages.append(item)
        received.append(messages)
    sessions = [subscriber.sample_statistics() for subscriber in subscribers]
    counters = transport.sample_statistics()
    presentation.close()
    return received, sessions, counters


def check_slip(messages, predictions, episode, checks):
    """The slip messages against `predictions.npz`, and the sums against the scans."""
    sensors = episode["piezo"].shape[1]
    for index, (message, transfer) in enumerate(messages):
        at = f"slip message {index}"
        checks.equal(f"{at}, transfer id", transfer.transfer_id, index % 32)
        checks.equal(f"{at}, sequence", message.sequence, index)
        checks.equal(f"{at}, sensors", message.sensors, sensors)
        checks.decision(index, message, message.logits_q8, predictions, episode["piezo"])


def decode(message):
    """Counts and samples of a raw message of either kind."""
    if hasattr(message, "data"):
        counts, sent, samples = compressed.decode(message, ACTIVE)
        return counts, bool((sent == ACTIVE).all()), samples
    counts = np.zeros((32, 32), np.uint16)
    counts[ACTIVE] = message.taxels
    return counts, True, np.array([[s.x, s.y, s.z] for s in message.xl], np.int16).reshape(-1, 3)


def check_raw(messages, slip_messages, episode, checks):
    """Rebuild the episode's arrays from the raw frames. Returns samples compared and left out."""
    piezo, xl, xl_end = episode["piezo"], episode["xl"], episode["xl_end"].astype(np.int64)
    sensors = piezo.shape[1]
    seen = np.zeros(xl_end.shape, np.int64)
    compared = left_out = 0
    for index, (message, transfer) in enumerate(messages):
        at = f"raw frame {index}"
        checks.equal(f"{at}, transfer id", transfer.transfer_id, index % 32)
        frame, sensor = int(message.sequence), int(message.sensor)
        if frame >= piezo.shape[0] or sensor >= sensors:
            checks.true(f"{at}: frame {frame} of sensor {sensor} is not in the episode", False)
            continue
        at += f" (frame {frame}, sensor {sensor})"
        seen[frame, sensor] += 1
        if frame < len(slip_messages):
            slip_message = slip_messages[frame][0]
            checks.equal(f"{at}, timestamp", message.timestamp_us, slip_message.timestamp_us)
            checks.equal(f"{at}, health", message.health, slip_message.contact[sensor].health)
        if hasattr(message, "check"):
            checks.equal(f"{at}, check", message.check, compressed.check(message))
        counts, whole, samples = decode(message)
        checks.true(f"{at}: not all taxels were sent", whole)
        checks.equal(f"{at}, taxels", counts, piezo[frame, sensor])
        end = int(message.xl_end)
        checks.equal(f"{at}, xl_end", end, xl_end[frame, sensor])
        before = xl_end[frame - 1, sensor] if frame else 0
        arrived = int(xl_end[frame, sensor] - before)
        sent = min(arrived, RAW_XL_MAX)
        checks.equal(f"{at}, xl_dropped", message.xl_dropped, min(arrived - sent, 255))
        checks.equal(f"{at}, xl", samples, xl[sensor, xl_end[frame, sensor] - sent : xl_end[frame, sensor]])
        compared += len(samples)
        left_out += int(message.xl_dropped)
    checks.true(f"raw frames: {np.count_nonzero(seen != 1)} of {seen.size} not seen exactly once", (seen == 1).all())
    return compared, left_out


def main():
    log, predictions, episode = sys.argv[1:]
    # pycyphal names lost frames, bad checksums and unreadable lines in its log.
    logging.basicConfig(level=logging.WARNING, format="pycyphal: %(message)s")
    with np.load(predictions) as file:
        predictions = {name: file[name] for name in ("class", "logits", "slip", "may_begin")}
    with np.load(episode) as file:
        episode = {name: file[name] for name in ("piezo", "xl", "xl_end")}
    frames, sensors = episode["piezo"].shape[:2]

    checks = Checks()
    lines, slips, plain, short = scan_log(log, sensors, checks)
    raws = plain + short
    checks.true(f"{plain} raw transfers and {short} compressed ones, need one kind", not (plain and short))
    checks.true(f"{sys.argv[3]}: no frames", frames > 0)
    checks.equal("rows of the predictions", len(predictions["class"]), frames)
    checks.equal("slip messages", slips, frames)
    checks.equal("raw transfers", raws, frames * sensors)
    if checks.bad:
        return 1

    with tempfile.TemporaryDirectory() as folder:
        pycyphal.dsdl.compile(DSDL, [], folder)
        sys.path.insert(0, folder)
        import slipsense

        types = (slipsense.Slip_2_0, slipsense.RawCompressed_1_0 if short else slipsense.Raw_1_0)
        checks.equal("subject of Slip", pycyphal.dsdl.get_fixed_port_id(types[0]), SLIP_PORT)
        checks.equal("subject of Raw", pycyphal.dsdl.get_fixed_port_id(types[1]), COMPRESSED_PORT if short else RAW_PORT)
        (slip, raw), sessions, counters = asyncio.run(receive(log, types, (slips, raws)))

    checks.equal("slip messages decoded", len(slip), slips)
    checks.equal("raw frames decoded", len(raw), raws)
    checks.equal("frames that pycyphal took", counters.in_frames_cyphal_accepted, lines)
    checks.equal("frames in error", counters.in_frames_errored, 0)
    for name, session in zip(("slip", "raw"), sessions):
        checks.equal(f"{name}: transport errors", session.transport_session.errors, 0)
        checks.equal(f"{name}: transport drops", session.transport_session.drops, 0)
        checks.equal(f"{name}: messages that do not decode", session.deserialization_failures, 0)
    check_slip(slip, predictions, episode, checks)
    compared, left_out = check_raw(raw, slip, episode, checks)

    print(
        f"{log}: {lines} CAN frames, {len(slip)} slip messages, {len(raw)} raw frames, "
        f"{len(raw) * int(ACTIVE.sum())} taxel counts and {compared} accelerometer samples compared "
        f"({left_out} reported as left out): {checks.bad} mismatches"
    )
    return 1 if checks.bad else 0


if __name__ == "__main__":
    sys.exit(main())
