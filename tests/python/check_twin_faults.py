"""What the firmware in the board twin does where its flash raises flags of reads, and what it reports after it faulted,
hung, panicked, its supply dipped, or a bit of its model flipped: asked by pycyphal.

  check_twin_faults.py PORT IMAGES N

IMAGES holds model.slip, a model that is taken. N stores of the settings, each 25th a transfer of that model instead.
The twin changes the first instructions of the firmware's handler CEC for each fault. Any mismatch is printed; the exit
status is then 1.
"""

import pathlib
import struct

from check_twin_update import MODEL, STORE, UpdateClient, threshold
from node_client import natural, run_checks

# What is no frame on the link: text that the twin follows.
ORDER = (1 << 31) | 1
# Of a million writes to the flash and its registers: every 50th meets a flag.
FLAGS_PER_MILLION = 20_000
UPDATE_EACH = 25
# slipsense.status.restart: cause and kind; of a fault PC, LR, CFSR, address; of a stall PC, LR, stalled tasks.
BROWN_OUT, SOFTWARE, WATCHDOG = 2, 4, 5
NONE, PANIC, HARD_FAULT, STALL = 0, 1, 2, 3
UNDEFINED_INSTRUCTION = 1 << 16
FAILED = 32
NO_DECISION = 2
SELF_TEST = 0
CODE = range(0x0802_0000, 0x0808_0000)


def order(client, text):
    client.link.socket.sendall(struct.pack("<IB", ORDER, len(text)) + text.encode())


async def check_flags(client, operations):
    """Every operation succeeds, though the flash says otherwise again and again."""
    checks = client.checks
    order(client, f"flags {FLAGS_PER_MILLION}")
    size = (client.folder / "model.slip").stat().st_size
    updates = 0
    for number in range(operations):
        if number % UPDATE_EACH == UPDATE_EACH // 2:
            await client.update(MODEL, "model.slip", f"model received and accepted, {size} bytes")
            updates += 1
            print(f"{number + 1} of {operations} stores and updates", flush=True)
        else:
            # There is a pause of ten seconds between stores, of the twin's clock; a start ends it.
            await client.restart()
            await client.access("slipsense.slip.point", threshold(number))
            checks.equal(f"store {number}", await client.command(STORE), 0)
    order(client, "flags 0")
    stored = await client.numbers("slipsense.slip.point")
    await client.restart()
    checks.equal("what was stored last", await client.numbers("slipsense.slip.point"), stored)
    checks.true("the model that was sent last", client.has_record("model: version 1.0.0 of the model slot"))
    return f"{operations - updates} stores and {updates} updates of the model with flags of reads"


async def check_restart(client, what, cause, kind):
    """The board restarts by itself: its register and its record say why."""
    checks = client.checks
    client.forget()
    client.heartbeats.clear()
    order(client, what)
    await client.started(what)
    numbers = await client.numbers("slipsense.status.restart")
    checks.equal(f"{what}: cause and kind", numbers[:2], [cause, kind])
    texts = [text for *_, text in client.records if text.startswith("restarted after ")]
    checks.equal(f"{what}: records", len(texts), 1)
    await client.until("a heartbeat", client.beats)
    checks.true(f"{what}: heartbeat says so", client.beats()[-1][0].vendor_specific_status_code & FAILED)
    return numbers, (texts or [""])[0]


async def check_memory(client):
    """A bit of the model that runs flips: found in the first pass, and reported."""
    checks = client.checks
    await client.restart()
    order(client, "model bit")
    await client.recorded("self check failed: the model in RAM")
    client.heartbeats.clear()
    await client.until("a heartbeat", client.beats)
    beat = client.beats()[-1][0]
    checks.equal("model bit: warning", (beat.health.value, beat.vendor_specific_status_code & NO_DECISION), (3, NO_DECISION))
    _, inferences, failed = await client.numbers("slipsense.status.self_checks")
    # A golden inference, at the start, may have met the flipped bit.
    checks.equal("golden inferences, failed checks", (inferences, failed & 7), (1, 1))
    checks.equal("model bit: errors of the RAMs", await client.numbers("slipsense.status.ram_errors"), [0, 1])
    checks.equal("model bit: self test", await client.command(SELF_TEST), 1)
    await client.restart()
    checks.equal("failed checks after a restart", (await client.numbers("slipsense.status.self_checks"))[2], 0)


async def run(checks, port, folder, operations):
    client = UpdateClient(checks, pathlib.Path(folder))
    await client.power_on(port)
    checks.equal("power-on", (await client.numbers("slipsense.status.restart"))[:2], [1, NONE])
    # Without raw messages the emulator has less to do.
    await client.access("slipsense.raw.divider", natural(8, 0))
    checks.equal("store", await client.command(STORE), 0)

    await check_memory(client)
    numbers, text = await check_restart(client, "hard fault", SOFTWARE, HARD_FAULT)
    handler, status = numbers[2], numbers[4]
    checks.equal("hard fault: status", status, UNDEFINED_INSTRUCTION)
    checks.true(f"hard fault: {text}", text.startswith(f"restarted after fault 1 since power-on, pc {handler:08x}, "))
    checks.true(f"hard fault: pc {handler:08x} is code", handler in CODE)
    numbers, text = await check_restart(client, "hang", WATCHDOG, STALL)
    checks.equal("hang: pc and stalled tasks", (numbers[2], numbers[4]), (handler, 0b1111))
    checks.true(f"hang: {text}", text.endswith(", stalled: acquire infer transmit services"))
    numbers, text = await check_restart(client, "panic", SOFTWARE, PANIC)
    checks.true(f"panic: {text}", text.startswith("restarted after panic 3 since power-on, at ") and ".rs:" in text)
    numbers, text = await check_restart(client, "brown-out", BROWN_OUT, NONE)
    checks.equal("brown-out", text, "restarted after a brown-out")
    await client.restart()
    checks.equal("a restart that was asked for", (await client.numbers("slipsense.status.restart"))[:2], [SOFTWARE, NONE])
    # As the chip is delivered.
    checks.equal("option bytes", await client.numbers("slipsense.status.option_bytes"), [0, 0])
    figures = await check_flags(client, int(operations))
    client.close()
    return f"flipped bit, hard fault, hang, panic and brown-out named; {figures}"


if __name__ == "__main__":
    run_checks("faults of the board twin", run)
