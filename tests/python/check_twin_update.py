#!/usr/bin/env python3
"""Update the board twin over the bus with pycyphal's file server, as a user's tool would: what is refused, what runs
after a restart, what rolls back, and what a supply that fails in between leaves.

  check_twin_update.py PORT --folder IMAGES

IMAGES holds what `cargo xtask test --only twin-update` signs: new.slip (firmware 0.2.0), older.slip (0.0.1), model.slip
(model 1.0.0 of any board) and other.slip (a model for another board). Any mismatch is printed; the exit status is then
1. Times are virtual and the twin's to print.
"""

import argparse
import asyncio
import logging
import os
import pathlib
import struct
import sys
import tempfile

import check_node
from check_node import NODE, Checks, natural, numbers
from check_twin_node import PATIENCE_S, TwinClient

# Of this computer, seconds: an update and a swap take a quarter of a minute of virtual time each.
LONG_S = 400.0
UPDATE, MODEL, RESTART, STORE = 65533, 1, 65535, 65530
# What is no frame on the link: at which step of the flash the supply fails.
SUPPLY = 1 << 31
# A store has fewer steps.
STORE_STEPS_MAX = 40
# Steps of an update: three erases, then a word for 32 bytes.
TRANSFER_STEPS = (2, 1_500)
# Of the swap, each counted from the restart after the one before: erases, words of a copy, words of the state.
SWAP_STEPS = (1, 2, 700, 4_096, 4_400, 9_000)


class UpdateClient(TwinClient):
    def __init__(self, checks, link, folder):
        super().__init__(checks)
        self.link, self.folder = link, folder

    def supply_fails_at(self, *steps):
        """At none, if none is named; each counts from the failure before."""
        self.link.socket.sendall(struct.pack(f"<IB{len(steps)}Q", SUPPLY, 8 * len(steps), *steps))

    async def said(self, text, timeout=LONG_S):
        await self.until(f"record: {text}", lambda: any(said == text for *_, said in self.records), timeout)

    async def young(self, what):
        """The first heartbeats of a new life."""
        beats = self.heartbeats_of_board
        await self.until(f"a young heartbeat after {what}", lambda: any(beat.uptime <= 1 for beat in beats()), LONG_S)

    def forget(self):
        self.heartbeats.clear()
        self.records.clear()

    async def restart(self):
        self.forget()
        self.checks.equal("restart", await self.command(RESTART, timeout=PATIENCE_S), 0)
        await self.young("a restart")

    async def version(self, want):
        import uavcan.node

        info = await self.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request(), timeout=PATIENCE_S)
        self.checks.equal("version in GetInfo", (info.software_version.major, info.software_version.minor), want)

    async def update(self, command, path, want):
        self.records.clear()
        self.checks.equal(f"update {path}", await self.command(command, path.encode(), timeout=PATIENCE_S), 0)
        await self.said(want)

    async def number(self, name):
        return numbers((await self.access(name)).value)[1][0]


async def check_refusals(client):
    folder = client.folder
    image = (folder / "new.slip").read_bytes()
    forged = bytearray(image)
    forged[70] ^= 1
    changed = bytearray(image)
    changed[5_000] ^= 1
    # The version is signed too.
    renumbered = bytearray(image)
    renumbered[15] = 9
    for name, content in [
        ("forged.slip", forged),
        ("renumbered.slip", renumbered),
        ("unsigned.slip", image[:64] + bytes(64) + image[128:]),
        ("short.slip", image[:100]),
        ("cut.slip", image[:3_000]),
        ("plain.slip", image[128:]),
    ]:
        (folder / name).write_bytes(bytes(content))
    for name, why in [
        ("forged.slip", "the signature is not by this firmware's key"),
        ("renumbered.slip", "the signature is not by this firmware's key"),
        ("unsigned.slip", "unsigned: the signature is empty"),
        ("short.slip", "truncated: shorter than the header of an image"),
        ("plain.slip", "unsigned: it has no image header"),
        ("older.slip", "older than what is installed"),
        ("model.slip", "firmware and model mistaken for each other"),
        ("none.slip", "the server has no such file"),
        ("cut.slip", "truncated: it ends before its payload does"),
    ]:
        await client.update(UPDATE, name, f"firmware not taken: {why}")
    await client.update(MODEL, "other.slip", "model not taken: for another board")
    await client.restart()
    await client.version((0, 1))


async def check_settings(client):
    """Brown-outs in the middle of a store: at the first step of the flash, at the second, and so on, until one is
    through before the supply fails."""
    import uavcan.node

    checks, old, kept = client.checks, 1, 0
    store = uavcan.node.ExecuteCommand_1.Request(command=STORE)
    for step in range(1, STORE_STEPS_MAX):
        new = old % 3 + 1
        await client.access("slipsense.sensors", natural(8, new))
        # Without raw messages the emulator has less to do.
        await client.access("slipsense.raw.divider", natural(8, 0))
        client.heartbeats.clear()
        client.supply_fails_at(step)
        answer = asyncio.ensure_future(client.clients[uavcan.node.ExecuteCommand_1, NODE](store))
        restarted = lambda: any(beat.uptime == 0 for beat in client.heartbeats_of_board())
        await client.until(f"a store, step {step}", lambda: answer.done() or restarted())
        client.supply_fails_at()
        if answer.done():
            checks.equal("a whole store", answer.result().status, 0)
            checks.equal("settings", await client.number("slipsense.sensors"), new)
            return f"stores cut off at each of {step - 1} steps: {kept} times the old settings, {step - 1 - kept} the new"
        answer.cancel()
        found = await client.number("slipsense.sensors")
        checks.true(f"cut off at step {step}: {found} is old {old} or new {new}", found in (old, new))
        checks.equal("damage", await client.number("slipsense.status.settings_damage"), 0)
        kept += found == old
        old = found
    checks.true("a store ends", False)


async def check_update(client):
    """To a new firmware, back because it did not confirm, and to it again; the supply fails on the way."""
    checks = client.checks
    size = (client.folder / "new.slip").stat().st_size
    received = f"firmware received and accepted, {size} bytes"
    for step in TRANSFER_STEPS:
        client.forget()
        client.supply_fails_at(step)
        checks.equal("update", await client.command(UPDATE, b"new.slip", timeout=PATIENCE_S), 0)
        await client.young(f"an update cut off at step {step} of the flash")
        await client.said("firmware 0.1.0, confirmed")
        await client.version((0, 1))
    await client.update(UPDATE, "new.slip", received)
    late = await client.number("slipsense.status.late_frames"), await client.number("slipsense.status.overruns")
    await client.restart()
    await client.said("firmware 0.2.0, on trial: a restart before it confirms brings back the one before")
    await client.version((0, 2))
    await client.update(UPDATE, "new.slip", "firmware not taken: the firmware that runs has not confirmed yet")
    await client.restart()
    await client.said("firmware 0.1.0, back: the one after it did not confirm")
    await client.version((0, 1))
    await client.update(UPDATE, "new.slip", received)
    # The first of them counts from here on, over the restart that swaps; each other one from the restart that the one
    # before was.
    client.forget()
    client.supply_fails_at(*SWAP_STEPS)
    checks.equal("restart", await client.command(RESTART, timeout=PATIENCE_S), 0)
    await client.young("a swap that was cut off again and again")
    await client.said("firmware 0.2.0, on trial: a restart before it confirms brings back the one before")
    await client.version((0, 2))
    await client.said("firmware 0.2.0 has confirmed")
    await client.restart()
    await client.said("firmware 0.2.0, confirmed")
    await client.version((0, 2))
    await client.update(UPDATE, "older.slip", "firmware not taken: older than what is installed")
    return f"{size} bytes of firmware; during the first transfer {late[0]} frames late, {late[1]} dropped"


async def check_model(client):
    size = (client.folder / "model.slip").stat().st_size
    await client.update(MODEL, "model.slip", f"model received and accepted, {size} bytes")
    await client.restart()
    await client.said("model: version 1.0.0 of the model slot")


async def run(checks, link, folder):
    import pycyphal.application.file

    client = UpdateClient(checks, link, folder)
    # Lives as long as the node.
    pycyphal.application.file.FileServer(client.node, [folder])
    await client.until("a first heartbeat", lambda: client.heartbeats_of_board())
    await client.restart()
    for notice in (
        "updates: development key built in, anybody can sign; SLIPSENSE_UPDATE_KEY sets another",
        "firmware 0.1.0, confirmed",
        "model: the one in the firmware",
    ):
        await client.said(notice)
    settings = await check_settings(client)
    await check_refusals(client)
    update = await check_update(client)
    await check_model(client)
    client.node.close()
    return f"{settings}; {update}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("port", type=int)
    parser.add_argument("--folder", type=pathlib.Path, required=True)
    args = parser.parse_args()
    logging.basicConfig(level=logging.ERROR, format="pycyphal: %(message)s")
    for name in [name for name in os.environ if name.startswith("UAVCAN__")]:
        del os.environ[name]
    checks = Checks()
    with tempfile.TemporaryDirectory() as folder:
        import pycyphal.dsdl

        sources, compiled = pathlib.Path(folder) / "dsdl", pathlib.Path(folder) / "python"
        pycyphal.dsdl.compile_all([check_node.regulated_types.write(sources)], compiled)
        sys.path.insert(0, str(compiled))
        link = check_node.can_link.CanLink(args.port, check_node.CHANNEL)
        figures = asyncio.run(run(checks, link, args.folder))
        link.close()
    print(f"updates of the board twin: {checks.count} checks by pycyphal, {checks.bad} mismatches; {figures}")
    return 1 if checks.bad else 0


if __name__ == "__main__":
    sys.exit(main())
