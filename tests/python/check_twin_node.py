"""Let pycyphal talk to the firmware in the board twin: what the release ELF answers through the modelled bus.

  check_twin_node.py PORT MODEL_FILE

The board has no accelerometers here, so its health is Caution and its self test fails. Virtual time is neither
faster nor slower than the clock of this computer by a known factor: nothing here measures a time of the board by it.
Any mismatch is printed; the exit status is then 1.
"""

import asyncio
import hashlib
import pathlib
import random
import subprocess

from can_link import CanLink
from node_client import NODE, TOOL, Client, natural, numbers, run_checks

import pycyphal.application.plug_and_play
import uavcan.node
import uavcan.pnp
import uavcan.primitive
import uavcan.register
import uavcan.time

CAUTION, OPERATIONAL, SENSOR_MISSING = 2, 0, 1
MASTER_EPOCH_US = 1_700_000_000_000_000


async def check_identity(client, model):
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


async def check_registers(client):
    checks = client.checks
    names = []
    while True:
        request = uavcan.register.List_1.Request(index=len(names))
        answer = await client.call(uavcan.register.List_1, request)
        name = bytes(answer.name.name).decode()
        if not name:
            break
        names.append(name)
    checks.equal("registers are named once", len(set(names)), len(names))
    for wanted in ("uavcan.node.id", "uavcan.can.bitrate", "slipsense.sensors", "slipsense.status.bus_off"):
        checks.true(f"register {wanted}", wanted in names)
    values = {}
    for name in names:
        answer = await client.access(name)
        checks.true(f"{name} has a value", answer.value.empty is None)
        values[name] = (answer, numbers(answer.value))
    for name in names:
        if f"{name}=" not in values:
            continue
        kind, default = values[f"{name}="][1]
        checks.equal(f"{name}: default", values[name][1], (kind, default))
        checks.true(f"{name}: mutable, persistent", values[name][0].mutable and values[name][0].persistent)
        for low, number, high in zip(values[f"{name}>"][1][1], default, values[f"{name}<"][1][1]):
            checks.true(f"{name}: {low} <= {number} <= {high}", low <= number <= high)
    checks.equal("no such register", (await client.access("no.such.register")).value.empty is None, False)

    async def write(name, value, want):
        checks.equal(f"{name} after a write", await client.numbers(name, value), want)
        checks.equal(f"{name} read again", await client.numbers(name), want)

    await write("slipsense.sensors", natural(8, 3), [3])
    await write("slipsense.sensors", natural(8, 4), [3])
    await write("uavcan.can.bitrate", natural(32, 1_000_000, 5_000_000), [1_000_000, 5_000_000])
    await write("uavcan.can.bitrate", natural(32, 1_000_000, 4_000_000), [1_000_000, 5_000_000])
    text = uavcan.register.Value_1(string=uavcan.primitive.String_1(list(b"2")))
    await write("slipsense.sensors", text, [3])
    mask = [random.getrandbits(32) for _ in range(32)]
    await write("slipsense.sensor.1.mask", natural(32, *mask), mask)
    await write("slipsense.status.bus_off", natural(32, 7), [0])
    refusal = "slipsense.sensors: element 0 is 4, allowed are 1 to 3"
    await client.until("a record names the refusal", lambda: client.has_record(refusal))
    return len(names)


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
    checks.equal("update without path", await client.command(65533), 4)
    checks.equal("update", await client.command(65533, b"x.bin"), 0)
    checks.equal("unknown command", await client.command(1234), 3)


async def check_time(client):
    """Two messages a moment apart: the second says when the first was sent, on a clock of our own."""
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


async def check_allocation(client):
    """Without an address of its own the node is silent but for asking, and takes the one that it is given."""
    checks = client.checks
    # The update that nobody serves is over with this.
    await client.restart()
    unique_id = (await client.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request())).unique_id
    requests = []

    async def note(_, transfer):
        if transfer.source_node_id is None:
            requests.append(transfer)

    client.node.make_subscriber(uavcan.pnp.NodeIDAllocationData_2).receive_in_background(note)
    await client.access("uavcan.node.id", natural(16, 65535))
    checks.equal("store", await client.command(65530), 0)
    checks.equal("restart", await client.command(65535), 0)
    await client.until("a request for an address", lambda: requests)
    others = lambda: [node for node, *_ in client.heartbeats if node != TOOL]
    client.heartbeats.clear()
    # Half a second apart on the average, a heartbeat would be a second.
    await client.until("more requests", lambda: len(requests) >= 5)
    checks.equal("a node without address is silent", others(), [])
    allocator = pycyphal.application.plug_and_play.CentralizedAllocator(client.node)
    allocator.register_node(TOOL, None)
    await client.until("a heartbeat with an allocated address", others)
    address = others()[0]
    checks.true(f"address {address} is a free one", address not in (NODE, TOOL) and 0 <= address <= 125)
    info = await client.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request(), address)
    checks.equal("unique id after allocation", list(info.unique_id), list(unique_id))
    # Back to where it was.
    checks.equal("factory reset", await client.command(65532, server=address), 0)
    await client.restart(address)
    return address


async def run(checks, port, model):
    link = CanLink(port)
    client = Client(checks)
    await client.until("a first heartbeat", client.beats)
    await check_identity(client, pathlib.Path(model))
    await check_heartbeat(client)
    registers = await check_registers(client)
    await check_storage(client)
    await check_time(client)
    address = await check_allocation(client)
    client.node.close()
    link.close()
    frames = ", ".join(f"{count} frames {which}" for which, count in link.frames.items())
    return f"{registers} registers, address {address} allocated; {frames}"


if __name__ == "__main__":
    run_checks("node of the board twin", run)
