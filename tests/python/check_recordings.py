"""Check recordings that `slipsense record` wrote, and a DBC file, with the software that people open them with.

  check_recordings.py CAN_LOG RECORDING.mcap RECORDING.blf SLIP.dbc

python-can must find the frames and times of the log in the log and in the BLF file that `can.logconvert` made of it; the
package mcap every frame too, and messages
that follow their JSON schemas; cantools must decode every slip frame to what the MCAP file says, which our own decoder
wrote. Any mismatch is printed; the exit status is then 1.
"""

import base64
import collections
import json
import pathlib
import re
import sys

import can
import cantools
import jsonschema
from checks import Checks
from mcap.reader import make_reader

LINE = re.compile(r"\((\d+)\.(\d{6})\) \w+ ([0-9A-F]{8})##1((?:[0-9A-F]{2})*)\n")
SLIP_PORT = 6203


def main():
    log, mcap, blf, dbc = map(pathlib.Path, sys.argv[1:])
    checks = Checks()
    equal = checks.equal

    frames = []
    for line in log.read_text(encoding="ascii").splitlines(keepends=True):
        match = LINE.fullmatch(line)
        frames.append((int(match[1]) * 10**6 + int(match[2]), int(match[3], 16), bytes.fromhex(match[4])))

    for path, reader in ((log, can.CanutilsLogReader(log)), (blf, can.BLFReader(blf))):
        found = [
            (round(m.timestamp * 1e6), m.arbitration_id, bytes(m.data))
            for m in reader
            if m.is_fd and m.is_extended_id and m.bitrate_switch
        ]
        equal(f"{path}: frames", len(found), len(frames))
        for index, (got, want) in enumerate(zip(found, frames)):
            equal(f"{path}: frame {index}", got, want)

    topics = collections.Counter()
    found, slips, validators = [], [], {}
    with open(mcap, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            topics[schema.name] += 1
            value = json.loads(message.data)
            if schema.id not in validators:
                validators[schema.id] = jsonschema.Draft202012Validator(json.loads(schema.data))
            # One in ten: the validator is slow.
            if topics[schema.name] % 10 == 1:
                validators[schema.id].validate(value)
            equal("encoding", (schema.encoding, channel.message_encoding), ("jsonschema", "json"))
            if schema.name == "slipsense.CanFrame":
                found.append((message.log_time // 1000, value["id"], base64.b64decode(value["data"])))
            elif schema.name == "slipsense.Slip":
                slips.append(value)
            elif schema.name == "foxglove.RawImage":
                size = value["step"] * value["height"]
                equal("bytes of an image", (len(base64.b64decode(value["data"])), value["encoding"]), (size, "mono16"))
    # A reader goes by time, and frames of one tick have one time.
    equal(f"{mcap}: frames", sorted(found), sorted(frames))

    database = cantools.database.load_file(dbc)
    definition = database.get_message_by_name("Slip")
    equal("CAN FD in the DBC", definition.is_fd, True)
    equal("cycle time in the DBC, ms", float(definition.cycle_time), 4.167)
    slip_frames = [frame for frame in frames if frame[1] >> 8 & 0x1FFF == SLIP_PORT]
    equal("slip messages", len(slips), len(slip_frames))
    fields = 0
    for (_, identifier, data), want in zip(slip_frames, slips):
        equal("identifier in the DBC", definition.frame_id, identifier)
        got = definition.decode(data, decode_choices=False)
        equal("transfer_id", got["transfer_id"], data[63] & 31)
        for name in ("timestamp_us", "sequence", "class_index", "slip", "may_begin", "invalid", "degraded", "late_frames"):
            equal(name, got[name], want[name])
            fields += 1
        for index, logit in enumerate(want["logits"]):
            equal(f"logits_{index}", got[f"logits_{index}"], logit)
            fields += 1
        equal("sensors", got["sensors"], len(want["contact"]))
        for index, contact in enumerate(want["contact"]):
            for name, value in contact.items():
                equal(f"contact_{index}_{name}", got[f"contact_{index}_{name}"], value)
                fields += 1

    counts = ", ".join(f"{count} {name}" for name, count in sorted(topics.items()))
    print(
        f"{len(frames)} CAN frames in candump, BLF and MCAP ({counts}), {fields} fields of {len(slips)} slip messages "
        f"by cantools: {checks.bad} mismatches"
    )
    return 1 if checks.bad or not slips else 0


if __name__ == "__main__":
    sys.exit(main())
