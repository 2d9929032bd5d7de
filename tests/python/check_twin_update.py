"""Update the board twin over the bus with pycyphal's file server, as a user's tool would: what is refused, what runs
after a restart, what rolls back, and what a supply that fails in between leaves.

  check_twin_update.py PORT IMAGES MODEL_FILE [--thorough]

IMAGES holds what `cargo xtask test --only twin-update` signs: new.slip (firmware 0.2.0), hanging.slip (0.1.1, which
does nothing for ever), older.slip (0.0.1), foreign.slip (0.2.0 by another key) and, of any board, model.slip (1.0.0),
older-model.slip (0.9.0) and newer-model.slip (1.1.0); MODEL_FILE is the model that is in the firmware. With --thorough the
supply fails at more steps of the flash. Any mismatch is printed; the exit status is then 1. Times are virtual and the
twin's to print.
"""

import asyncio
import hashlib
import pathlib
import struct

from can_link import CanLink
from node_client import NODE, Client, natural, run_checks

import pycyphal.application.file
import uavcan.node
import uavcan.primitive.array
import uavcan.register

# Of this computer, seconds: erases and a swap take several virtual ones each, which the twin runs at a fraction of
# real time.
LONG_S = 600.0
UPDATE, MODEL, RESTART, STORE = 65533, 1, 65535, 65530
BAD_STATE = 5
# What is no frame on the link: at which steps of the flash the supply fails.
SUPPLY = 1 << 31
HEADER_BYTES = 128
WORD_BYTES = 32
# A step is an erase or a word of 32 bytes, counted from where the check says so.
STEPS_MAX = 60
# Of a store of the settings, which has sixteen: the first, one in the middle, the last.
STORE_STEPS = (1, 8, 16)
# Of an update with an image of one word: an erase of the slot; what marks it.
SHORT_STEPS = (3, 10)
# Of one of full length: words.
TRANSFER_STEPS = (2_000,)
TRANSFER_STEPS_MORE = (5, 2_000, 7_000, 11_900)
# Of the swap, each counted from the failure before: an erase, words of copies, the state.
SWAP_STEPS = (1, 700, 4_400, 9_000)
SWAP_STEPS_MORE = (1, 2, 3, 700, 4_096, 4_097, 4_098, 4_099, 4_100, 4_400, 8_194, 8_196, 9_000, 12_292)
# Of the model: in the middle of its words; with --thorough also around its last word and its header.
MODEL_STEPS = (1_000,)


class UpdateClient(Client):
    def __init__(self, checks, folder):
        super().__init__(checks)
        self.folder = folder
        self.link = None

    async def power_on(self, port):
        """The twin starts when the link is there, so that its first records are received."""
        # Lives as long as the node.
        pycyphal.application.file.FileServer(self.node, [self.folder])
        self.link = CanLink(port)
        await self.started("power-on")

    def close(self):
        self.node.close()
        self.link.close()

    def supply_fails_at(self, *steps):
        """At none, if none is named; each counts from the failure before."""
        self.link.socket.sendall(struct.pack(f"<IB{len(steps)}Q", SUPPLY, 8 * len(steps), *steps))

    async def recorded(self, text):
        await self.until(f"record: {text}", lambda: self.has_record(text), LONG_S)

    def has_started(self):
        """It lives anew since `forget`: this is the last thing that it says of itself when it starts."""
        return any(text.startswith("model: ") for *_, text in self.records)

    async def started(self, what):
        await self.until(f"a start after {what}", self.has_started, LONG_S)

    def forget(self):
        self.records.clear()

    async def restart(self):
        self.forget()
        self.checks.equal("restart", await self.command(RESTART), 0)
        await self.started("a restart")

    async def version(self, want):
        info = await self.call(uavcan.node.GetInfo_1, uavcan.node.GetInfo_1.Request())
        self.checks.equal("version in GetInfo", (info.software_version.major, info.software_version.minor), want)
        return info

    async def begin(self, command, path):
        self.forget()
        # After a refused image the node lets a second pass, of its own clock: the twin takes up to a minute for it.
        for _ in range(1_200):
            status = await self.command(command, path.encode())
            if status != BAD_STATE:
                break
            await asyncio.sleep(0.1)
        self.checks.equal(f"update {path}", status, 0)

    async def update(self, command, path, want):
        await self.begin(command, path)
        await self.recorded(want)


def threshold(value):
    """Of the flag, in the register of three numbers that holds it."""
    return uavcan.register.Value_1(integer32=uavcan.primitive.array.Integer32_1([value, 1, 1]))


async def check_settings(client, thorough):
    """Brown-outs in the middle of a store; afterwards the settings are the old or the new ones."""
    checks = client.checks
    # Without raw messages the emulator has less to do.
    await client.access("slipsense.raw.divider", natural(8, 0))
    await client.access("slipsense.slip.point", threshold(0))
    checks.equal("a whole store", await client.command(STORE), 0)
    # There is a pause of ten seconds between stores, of the twin's clock; a start ends it.
    await client.restart()
    store = uavcan.node.ExecuteCommand_1.Request(command=STORE)
    old, cut, kept = 0, 0, 0
    for step in range(1, STEPS_MAX) if thorough else STORE_STEPS:
        new = 100 + step
        await client.access("slipsense.slip.point", threshold(new))
        client.forget()
        client.supply_fails_at(step)
        answer = asyncio.ensure_future(client.clients[uavcan.node.ExecuteCommand_1, NODE](store))
        await client.until(f"a store, step {step}", lambda: answer.done() or client.has_started())
        client.supply_fails_at()
        if answer.done() and answer.result() is not None:
            checks.true(f"a store has {STORE_STEPS[-1]} steps, not {step - 1}", step == STORE_STEPS[-1] + 1)
            old = new
            break
        answer.cancel()
        found = await client.numbers("slipsense.slip.point")
        checks.true(f"cut off at step {step}: {found} is old {old} or new {new}", found in ([old, 1, 1], [new, 1, 1]))
        checks.equal("the other settings", await client.numbers("slipsense.raw.divider"), [0])
        checks.equal("damage", await client.numbers("slipsense.status.settings_damage"), [0])
        cut += 1
        kept += found == [old, 1, 1]
        old = found[0]
    checks.true("stores were cut off", cut >= len(STORE_STEPS))
    return old, f"{cut} stores cut off: {kept} times the old settings, {cut - kept} the new"


async def check_refusals(client):
    folder = client.folder
    image = (folder / "new.slip").read_bytes()
    changed = bytearray((folder / "model.slip").read_bytes())
    changed[5_000] ^= 1
    # The version is signed too.
    renumbered = bytearray(image)
    renumbered[15] = 9
    for name, content in [
        ("renumbered.slip", renumbered),
        ("unsigned.slip", image[:64] + bytes(64) + image[HEADER_BYTES:]),
        ("short.slip", image[:100]),
        ("cut.slip", image[:3_000]),
        ("plain.slip", image[HEADER_BYTES:]),
        ("changed.slip", changed),
    ]:
        (folder / name).write_bytes(bytes(content))
    refused = [
        (UPDATE, "foreign.slip", "the signature is not by this firmware's key"),
        (UPDATE, "renumbered.slip", "the signature is not by this firmware's key"),
        (UPDATE, "unsigned.slip", "unsigned: the signature is empty"),
        (UPDATE, "plain.slip", "unsigned: it has no image header"),
        (UPDATE, "short.slip", "truncated: shorter than the header of an image"),
        (UPDATE, "cut.slip", "truncated: it ends before its payload does"),
        (UPDATE, "older.slip", "older than what is installed"),
        (UPDATE, "model.slip", "firmware and model mistaken for each other"),
        (UPDATE, "none.slip", "the server has no such file"),
        (MODEL, "new.slip", "firmware and model mistaken for each other"),
        (MODEL, "changed.slip", "the payload's SHA-256 does not match"),
    ]
    for command, name, why in refused:
        await client.update(command, name, f"{'firmware' if command == UPDATE else 'model'} not taken: {why}")
    await client.version((0, 1))
    return len(refused)


async def check_rollback(client, thorough):
    """An image that hangs: the supply fails while it comes in, then it is swapped in and the watchdog ends it."""
    checks = client.checks
    size = (client.folder / "hanging.slip").stat().st_size
    received = f"firmware received and accepted, {size} bytes"
    cut = 0
    for step in range(1, STEPS_MAX) if thorough else SHORT_STEPS:
        client.supply_fails_at(step)
        await client.begin(UPDATE, "hanging.slip")
        await client.until(f"an update, step {step}", lambda: client.has_record(received) or client.has_started(), LONG_S)
        client.supply_fails_at()
        if client.has_record(received):
            break
        # If the last step is behind it, it has been tried, and did not confirm.
        await client.version((0, 1))
        cut += 1
    else:
        await client.update(UPDATE, "hanging.slip", received)
    checks.true("updates were cut off", cut >= len(SHORT_STEPS))
    await client.restart()
    await client.recorded("firmware 0.1.0, back: the one after it did not confirm")
    await client.version((0, 1))
    return cut


async def check_update(client, thorough):
    """To a new firmware; the supply fails during the transfer, the swap and while it confirms."""
    checks = client.checks
    size = (client.folder / "new.slip").stat().st_size
    transfer = TRANSFER_STEPS_MORE if thorough else TRANSFER_STEPS
    swap = SWAP_STEPS_MORE if thorough else SWAP_STEPS
    for step in transfer:
        client.supply_fails_at(step)
        await client.begin(UPDATE, "new.slip")
        await client.started(f"an update cut off at step {step} of the flash")
        await client.recorded("firmware 0.1.0, confirmed")
        await client.version((0, 1))
    await client.update(UPDATE, "new.slip", f"firmware received and accepted, {size} bytes")
    for counter in ("late_frames", "overruns"):
        checks.equal(f"{counter} during a transfer", await client.numbers(f"slipsense.status.{counter}"), [0])
    client.forget()
    # Each failure restarts the swap that this restart begins.
    client.supply_fails_at(*swap)
    checks.equal("restart", await client.command(RESTART), 0)
    await client.started("a swap that was cut off again and again")
    # Ten seconds from now: the first thing that confirming writes.
    client.supply_fails_at(1)
    await client.recorded("firmware 0.2.0, on trial: a restart before it confirms brings back the one before")
    await client.version((0, 2))
    await client.update(UPDATE, "new.slip", "firmware not taken: the firmware that runs has not confirmed yet")
    client.forget()
    await client.started("a confirmation that was cut off")
    await client.recorded("firmware 0.2.0, confirmed")
    await client.version((0, 2))
    await client.update(UPDATE, "hanging.slip", "firmware not taken: older than what is installed")
    return (
        f"{size} bytes of firmware, cut off: {len(transfer)} of its transfers, {len(swap)} times its swap, once its "
        f"confirmation; during a transfer no frame late or dropped"
    )


async def check_model(client, model, thorough):
    checks = client.checks
    size = (client.folder / "model.slip").stat().st_size
    # Behind the erase.
    last = 1 + -(-(size - HEADER_BYTES) // WORD_BYTES)
    steps = (1, 2, *MODEL_STEPS, last - 2, last, last + 2) if thorough else MODEL_STEPS
    for step in steps:
        client.supply_fails_at(step)
        await client.begin(MODEL, "model.slip")
        await client.started(f"a model cut off at step {step} of the flash")
        built_in = any(text.startswith("model: the one in the firmware") for *_, text in client.records)
        checks.true("the model in the firmware runs", built_in)
    await client.update(MODEL, "model.slip", f"model received and accepted, {size} bytes")
    await client.restart()
    await client.recorded("model: version 1.0.0 of the model slot")
    info = await client.version((0, 2))
    digest = hashlib.sha256(model.read_bytes()[:-32]).digest()
    checks.equal("model", [int(crc) for crc in info.software_image_crc], [int.from_bytes(digest[:8], "big")])
    await client.until("the model's confirmation", lambda: client.has_record("model 1.0.0 has confirmed"), LONG_S)
    # A newer one that is cut off leaves no model in the slot, and the floor.
    client.supply_fails_at(*MODEL_STEPS)
    await client.begin(MODEL, "newer-model.slip")
    await client.started("a newer model that was cut off")
    await client.update(MODEL, "older-model.slip", "model not taken: older than what is installed")
    return len(steps) + 1


async def run(checks, port, folder, model, *thorough):
    client = UpdateClient(checks, pathlib.Path(folder))
    await client.power_on(port)
    for notice in (
        "updates: development key built in, anybody can sign; SLIPSENSE_UPDATE_KEY sets another",
        "firmware 0.1.0, confirmed",
        "model: the one in the firmware",
    ):
        await client.recorded(notice)
    stored, settings = await check_settings(client, thorough)
    refused = await check_refusals(client)
    short = await check_rollback(client, thorough)
    update = await check_update(client, thorough)
    models = await check_model(client, pathlib.Path(model), thorough)
    checks.equal("settings at the end", await client.numbers("slipsense.slip.point"), [stored, 1, 1])
    client.close()
    return (
        f"{refused} images refused; {settings}; {short} short updates cut off; {update}; "
        f"{models} transfers of a model cut off"
    )


if __name__ == "__main__":
    run_checks("updates of the board twin", run)
