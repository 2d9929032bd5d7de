#!/usr/bin/env python3
"""Let pycyphal talk to the node behind a TCP port: every service, as a user's tool would.

  check_node.py PORT [--name TEXT]

The node is the library's; what it says is decoded by pycyphal from definitions of the regulated types. Any mismatch
is printed; the exit status is then 1.
"""

import argparse
import asyncio
import hashlib
import pathlib
import random
import sys
import tempfile
import time

from node_client import CHANNEL, MASTER, NODE, TOOL, Client, frame_counts, link_to, natural, numbers, run_checks

FILE_BYTES = 100_000


async def check_identity(client):
    import uavcan.node

    checks = client.checks
    info = await client.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request())
    checks.equal("name", bytes(info.name).decode(), "slipsense.fingertip")
    checks.equal("protocol", (info.protocol_version.major, info.protocol_version.minor), (1, 0))
    checks.equal("hardware", (info.hardware_version.major, info.hardware_version.minor), (0, 1))
    checks.equal("commit", int(info.software_vcs_revision_id), 0xC0FFEE0012345678)
    checks.equal("unique id", bytes(info.unique_id)[:10], b"slipsense ")
    model = hashlib.sha256(b"no model").digest()
    checks.equal("model", [int(crc) for crc in info.software_image_crc], [int.from_bytes(model[:8], "big")])
    answer = await client.access("slipsense.model.hash")
    checks.equal("model hash", bytes(answer.value.unstructured.value), model)
    return bytes(info.unique_id)


async def check_heartbeat(client):
    await client.until("three heartbeats", lambda: len(client.beats()) >= 3)
    beats = client.beats()[-3:]
    for (first, before), (second, after) in zip(beats, beats[1:]):
        client.checks.equal("uptime between heartbeats", second.uptime - first.uptime, 1)
        client.checks.true(f"a second between heartbeats: {after - before:.3f} s", 0.5 < after - before < 1.5)
    client.checks.equal("health, mode", (beats[-1][0].health.value, beats[-1][0].mode.value), (0, 0))


async def check_registers(client):
    import uavcan.primitive
    import uavcan.register

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
    checks.equal("store", await client.command(65530), 0)
    await client.restart()
    checks.equal("stored, there", await client.numbers("slipsense.sensors"), [2])
    checks.equal("self test", await client.command(0), 0)
    checks.equal("self tests", await client.numbers("slipsense.status.self_tests"), [1, 0])
    checks.equal("factory reset", await client.command(65532), 0)
    await client.restart()
    checks.equal("factory reset, default", await client.numbers("slipsense.sensors"), [1])
    checks.equal("unknown command", await client.command(1234), 3)
    checks.equal("update without path", await client.command(65533), 4)


async def check_time(client):
    import uavcan.time
    from pycyphal.transport.can import CANTransport
    from pycyphal.transport.can.media.pythoncan import PythonCANMedia
    from pycyphal.presentation import Presentation

    checks = client.checks
    answer = await client.access("slipsense.sensors")
    checks.equal("time before synchronization", answer.timestamp.microsecond, 0)
    master = Presentation(CANTransport(PythonCANMedia(f"virtual:{CHANNEL}", (1_000_000, 8_000_000), 64), local_node_id=MASTER))
    publisher = master.make_publisher_with_fixed_subject_id(uavcan.time.Synchronization_1)
    now_us = lambda: int(time.time() * 1e6)
    previous = 0
    for _ in range(4):
        message = uavcan.time.Synchronization_1(previous_transmission_timestamp_microsecond=previous)
        sent = now_us()
        checks.true("synchronization sent", await publisher.publish(message))
        previous = (sent + now_us()) // 2
        await asyncio.sleep(0.5)
    before = now_us()
    answer = await client.access("slipsense.time.offset_us")
    after = now_us()
    error_us = int(answer.timestamp.microsecond) - (before + after) // 2
    checks.true(f"bus time of the node is off by {error_us} us", abs(error_us) < 100_000 + (after - before))
    master.close()
    return error_us


async def check_files(client):
    import pycyphal.application.file

    checks = client.checks
    rng = random.Random(7)
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        image = rng.randbytes(FILE_BYTES - 32)
        (folder / "good.bin").write_bytes(image + hashlib.sha256(image).digest())
        (folder / "bad.bin").write_bytes(image[:3000] + bytes(32))
        # Lives as long as the node.
        pycyphal.application.file.FileServer(client.node, [folder])

        async def update(command, path, want, pauses=False):
            client.records.clear()
            client.heartbeats.clear()
            began = time.monotonic()
            status = await client.command(command, path.encode())
            if pauses:
                checks.equal(f"update {path} in the pause after a wrong one", status, 5)
                while status == 5 and time.monotonic() < began + 30.0:
                    await asyncio.sleep(0.2)
                    status = await client.command(command, path.encode())
            checks.equal(f"update {path}", status, 0)
            await client.until(f"record: {want}", lambda: client.has_record(want), 60.0)
            return time.monotonic() - began

        took = await update(65533, "good.bin", f"firmware received and accepted, {FILE_BYTES} bytes")
        modes = {beat.mode.value for beat, _ in client.beats()}
        checks.true(f"modes seen {modes}", took < 2.5 or 3 in modes)
        await update(1, "good.bin", f"model received and accepted, {FILE_BYTES} bytes")
        await update(1, "bad.bin", "model not taken: hash wrong")
        await update(65533, "none.bin", "firmware not taken: the server has no such file", pauses=True)
    return took


async def check_allocation(client, unique_id):
    import pycyphal.application.plug_and_play
    import uavcan.node

    checks = client.checks
    await client.access("uavcan.node.id", natural(16, 65535))
    checks.equal("store", await client.command(65530), 0)
    checks.equal("restart", await client.command(65535), 0)
    await asyncio.sleep(1.5)
    client.heartbeats.clear()
    await asyncio.sleep(2.5)
    checks.equal("a node without address is silent", [node for node, *_ in client.heartbeats if node != TOOL], [])
    allocator = pycyphal.application.plug_and_play.CentralizedAllocator(client.node)
    allocator.register_node(TOOL, None)
    others = lambda: [node for node, *_ in client.heartbeats if node != TOOL]
    await client.until("a heartbeat with an allocated address", others)
    address = others()[0]
    checks.true(f"address {address} is a free one", address not in (NODE, TOOL) and 0 <= address <= 125)
    info = await client.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request(), address)
    checks.equal("unique id after allocation", bytes(info.unique_id), unique_id)
    # Back to where it was.
    checks.equal("factory reset", await client.command(65532, server=address), 0)
    await client.restart(address)
    return address


async def run(checks, port):
    link = link_to(port)
    client = Client(checks)
    # A long way: the emulated board has to boot.
    await client.until("a first heartbeat", client.beats, 30.0)
    unique_id = await check_identity(client)
    await check_heartbeat(client)
    registers = await check_registers(client)
    await check_storage(client)
    error_us = await check_time(client)
    took = await check_files(client)
    address = await check_allocation(client, unique_id)
    client.node.close()
    link.close()
    return (
        f"{registers} registers, {FILE_BYTES} bytes of a file in {took:.1f} s, bus time within {abs(error_us)} us, "
        f"address {address} allocated; {frame_counts(link)}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("--name", default="node")
    args = parser.parse_args()
    return run_checks(args.name, lambda checks: run(checks, args.port))


if __name__ == "__main__":
    sys.exit(main())
