#!/usr/bin/env python3
"""Let pycyphal talk to the firmware in the board twin: what the release ELF answers through the modelled bus.

  check_twin_node.py PORT --model FILE

The board has no accelerometers here, so its health is Caution and its self test fails. Virtual time is neither
faster nor slower than the clock of this computer by a known factor: nothing here measures a time of the board by it.
Any mismatch is printed; the exit status is then 1.
"""

import argparse
import asyncio
import hashlib
import pathlib
import subprocess
import sys

from check_node import check_registers
from node_client import Client, frame_counts, link_to, natural, numbers, run_checks

# Of this computer, seconds; the twin may run at a twentieth of real time.
TIMEOUT_S = 120.0
CAUTION, OPERATIONAL, SENSOR_MISSING = 2, 0, 1
MASTER_EPOCH_US = 1_700_000_000_000_000


async def check_identity(client, model):
    import uavcan.node

    checks = client.checks
    info = await client.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request())
    checks.equal("name", bytes(info.name).decode(), "slipsense.fingertip")
    checks.equal("hardware", (info.hardware_version.major, info.hardware_version.minor), (1, 0))
    commit = subprocess.run(["git", "rev-parse", "HEAD"], capture_output=True, text=True).stdout.strip()
    checks.equal("commit", f"{int(info.software_vcs_revision_id):016x}", commit[:16] or "0" * 16)
    digest = hashlib.sha256(model.read_bytes()[:-32]).digest()
    checks.equal("model", [int(crc) for crc in info.software_image_crc], [int.from_bytes(digest[:8], "big")])
    answer = await client.access("slipsense.model.hash")
    checks.equal("model hash", bytes(answer.value.unstructured.value), digest)


async def check_heartbeat(client):
    client.heartbeats.clear()
    await client.until("two heartbeats", lambda: len(client.beats()) >= 2)
    (first, _), (second, _) = client.beats()[:2]
    client.checks.equal("uptime between heartbeats", second.uptime - first.uptime, 1)
    client.checks.equal("health", second.health.value, CAUTION)
    client.checks.equal("mode", second.mode.value, OPERATIONAL)
    client.checks.equal("vendor status", second.vendor_specific_status_code & SENSOR_MISSING, SENSOR_MISSING)


async def check_storage(client):
    checks = client.checks
    await client.restart()
    checks.equal("not stored, gone", await client.numbers("slipsense.sensors"), [1])
    await client.access("slipsense.sensors", natural(8, 2))
    await client.access("slipsense.raw.divider", natural(8, 5))
    checks.equal("store", await client.command(65530), 0)
    await client.restart()
    checks.equal("stored, there", await client.numbers("slipsense.sensors"), [2])
    checks.equal("stored too", await client.numbers("slipsense.raw.divider"), [5])
    missing = await client.numbers("slipsense.status.sensor_health")
    checks.true(f"two sensors without accelerometers: {missing}", [bits & 2 for bits in missing] == [2, 2, 0])
    checks.equal("self test", await client.command(0), 1)
    checks.equal("self tests", await client.numbers("slipsense.status.self_tests"), [1, 1])
    wanted = "self test: an accelerometer does not deliver"
    await client.until("a record says why", lambda: client.has_record(wanted))
    checks.equal("factory reset", await client.command(65532), 0)
    await client.restart()
    checks.equal("factory reset, default", await client.numbers("slipsense.sensors"), [1])
    checks.equal("update", await client.command(65533, b"x.bin"), 0)
    checks.equal("unknown command", await client.command(1234), 3)


async def check_time(client):
    """Two messages a moment apart: the second says when the first was sent, on a clock of our own."""
    import uavcan.time

    checks = client.checks
    publisher = client.node.make_publisher(uavcan.time.Synchronization_1)
    checks.equal("time before", (await client.access("slipsense.sensors")).timestamp.microsecond, 0)
    first = uavcan.time.Synchronization_1(previous_transmission_timestamp_microsecond=0)
    second = uavcan.time.Synchronization_1(previous_transmission_timestamp_microsecond=MASTER_EPOCH_US)
    for message in (first, second):
        checks.true("synchronization sent", await publisher.publish(message))
        await asyncio.sleep(0.05)
    [offset] = await client.numbers("slipsense.time.offset_us")
    answer = await client.access("slipsense.status.uptime_s")
    now_us = int(answer.timestamp.microsecond)
    checks.true(f"bus time {now_us}", MASTER_EPOCH_US <= now_us < MASTER_EPOCH_US + 1_000_000_000)
    uptime_us = now_us - offset
    uptime_s = numbers(answer.value)[1][0]
    checks.equal("uptime by the bus time and the offset", uptime_us // 1_000_000, uptime_s)


async def run(checks, port, model):
    link = link_to(port)
    client = Client(checks, TIMEOUT_S)
    await client.until("a first heartbeat", client.beats)
    await check_identity(client, model)
    await check_heartbeat(client)
    registers = await check_registers(client)
    await check_storage(client)
    await check_time(client)
    client.node.close()
    link.close()
    return f"{registers} registers; {frame_counts(link)}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("--model", type=pathlib.Path, required=True)
    args = parser.parse_args()
    return run_checks("node of the board twin", lambda checks: run(checks, args.port, args.model))


if __name__ == "__main__":
    sys.exit(main())
