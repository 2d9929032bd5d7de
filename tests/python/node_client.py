"""A tool's node on the bus, by pycyphal, and what the checks of our node share: counting, values of registers, and the
set-up of a check. Frames go through a python-can bus of kind `virtual`.
"""

import asyncio
import logging
import os
import sys
import time
import warnings

# One of pycyphal's dependencies warns about another on Python 3.11.
warnings.filterwarnings("ignore", category=DeprecationWarning)

import regulated_types  # noqa: F401  makes `uavcan`
import pycyphal.application
import uavcan.diagnostic
import uavcan.node
import uavcan.primitive.array
import uavcan.register
from can_link import CHANNEL
from checks import Checks
from pycyphal.transport.can import CANTransport
from pycyphal.transport.can.media.pythoncan import PythonCANMedia

NODE, TOOL = 42, 120
# Of this computer, seconds; the twin may run at a twentieth of real time.
TIMEOUT_S = 120.0


class Client:
    """A tool's node on the bus and what it receives from ours."""

    def __init__(self, checks):
        self.checks = checks
        media = PythonCANMedia(f"virtual:{CHANNEL}", (1_000_000, 8_000_000), 64)
        transport = CANTransport(media, local_node_id=TOOL)
        info = pycyphal.application.NodeInfo(name="org.slipsense.check")
        self.node = pycyphal.application.make_node(info, transport=transport)
        self.node.start()
        self.records, self.heartbeats, self.clients = [], [], {}
        self.node.make_subscriber(uavcan.diagnostic.Record_1).receive_in_background(self._record)
        self.node.make_subscriber(uavcan.node.Heartbeat_1).receive_in_background(self._heartbeat)

    async def _record(self, message, transfer):
        self.records.append((transfer.source_node_id, message.severity.value, bytes(message.text).decode()))

    async def _heartbeat(self, message, transfer):
        self.heartbeats.append((transfer.source_node_id, message, time.monotonic()))

    async def call(self, kind, request, server=NODE):
        # Kept: a client that is closed forgets its transfer identifier, and the node takes the next call for
        # a repetition.
        if (kind, server) not in self.clients:
            self.clients[kind, server] = self.node.make_client(kind, server)
        client = self.clients[kind, server]
        client.response_timeout = TIMEOUT_S
        answer = await client(request)
        self.checks.true(f"{kind.__module__} of node {server} answered", answer is not None)
        return answer

    async def command(self, number, parameter=b"", server=NODE):
        request = uavcan.node.ExecuteCommand_1.Request(command=number, parameter=list(parameter))
        answer = await self.call(uavcan.node.ExecuteCommand_1, request, server)
        return None if answer is None else answer.status

    async def access(self, name, value=None):
        request = uavcan.register.Access_1.Request(name=uavcan.register.Name_1(list(name.encode())))
        if value is not None:
            request.value = value
        return await self.call(uavcan.register.Access_1, request)

    async def numbers(self, name, value=None):
        """The numbers in a register, after a write if there is a value."""
        return numbers((await self.access(name, value)).value)[1]

    def beats(self):
        """Heartbeats of our node, with the time of each."""
        return [(beat, at) for node, beat, at in self.heartbeats if node == NODE]

    def has_record(self, text):
        return any(record == text for *_, record in self.records)

    async def restart(self, server=NODE):
        """Restart and wait for the first heartbeat of the new life."""
        self.heartbeats.clear()
        self.checks.equal("restart", await self.command(65535, server=server), 0)
        await self.until("a young heartbeat after a restart", lambda: any(beat.uptime <= 1 for beat, _ in self.beats()))

    async def until(self, what, condition, timeout_s=TIMEOUT_S):
        deadline = time.monotonic() + timeout_s
        while not condition() and time.monotonic() <= deadline:
            await asyncio.sleep(0.02)
        self.checks.true(what, condition())


def numbers(value):
    """The numbers in a register's value, whatever their kind."""
    kinds = ["bit"] + [f"{name}{bits}" for name in ("integer", "natural") for bits in (64, 32, 16, 8)]
    for kind in kinds:
        array = getattr(value, kind)
        if array is not None:
            return kind, [int(number) for number in array.value]
    return None, []


def natural(bits, *values):
    array = getattr(uavcan.primitive.array, f"Natural{bits}_1")
    return uavcan.register.Value_1(**{f"natural{bits}": array(list(values))})


def run_checks(what, run):
    """Let `run(checks, *arguments of the command line)` talk to the node; print what it returns beside the count, and end
    with the exit status."""
    # pycyphal names transport errors in its log.
    logging.basicConfig(level=logging.ERROR, format="pycyphal: %(message)s")
    for name in [name for name in os.environ if name.startswith("UAVCAN__")]:
        del os.environ[name]
    checks = Checks()
    figures = asyncio.run(run(checks, *sys.argv[1:]))
    print(f"{what}: {checks.count} checks by pycyphal, {checks.bad} mismatches; {figures}")
    sys.exit(1 if checks.bad else 0)
