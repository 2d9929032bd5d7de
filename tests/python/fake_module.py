"""What a module says beside its slip and raw messages, from the Cyphal specification: written into a log, or said by a
module of its own behind an slcan adapter on TCP."""

import binascii
import re
import socket
import threading
import time

NODE, NOMINAL = 42, 4
HEARTBEAT, RECORD = 7509, 8184
COMMAND, ACCESS = 435, 384
FD_LENGTHS = [*range(9), 12, 16, 20, 24, 32, 48, 64]
FRAME = re.compile(r"\((\d+\.\d+)\) \S+ ([0-9A-F]{8})##.([0-9A-F]*)")
MASKED = [(3, 7), (16, 16)]
STUCK, MEASUREMENT = "slipsense.sensor.0.stuck", "slipsense.status.measurement"
CALIBRATION = "3 1a2b3c4d"


def message_id(subject):
    return NOMINAL << 26 | 3 << 21 | subject << 8 | NODE


def service_id(source, destination, port, request):
    return NOMINAL << 26 | 1 << 25 | request << 24 | port << 14 | destination << 7 | source


def transfer(identifier, number, payload):
    """The frames, identifier and data: a CRC where it takes several, zeros up to a length of CAN FD before it."""
    crc = 2 if len(payload) > 63 else 0
    last = (len(payload) + crc - 1) % 63 + 1
    payload += bytes(next(length for length in FD_LENGTHS if length > last) - 1 - last)
    payload += binascii.crc_hqx(payload, 0xFFFF).to_bytes(2, "big") if crc else b""
    parts = [payload[at : at + 63] for at in range(0, len(payload), 63)]
    for index, part in enumerate(parts):
        tail = number % 32 | 0x80 * (index == 0) | 0x40 * (part is parts[-1]) | 0x20 * (index % 2 == 0)
        yield identifier, part + bytes([tail])


def numbers(values, size):
    """The answer of uavcan.register.Access: natural32 or natural16."""
    return bytes(8) + bytes([{4: 9, 2: 10}[size], len(values)]) + b"".join(value.to_bytes(size, "little") for value in values)


def stuck(name=STUCK):
    """The register of a sensor's masked taxels."""
    rows = [0] * 32
    for row, col in MASKED if name == STUCK else []:
        rows[row] |= 1 << col
    return numbers(rows, 4)


def news(client, number):
    """A heartbeat with an advisory, the calibration, and somebody's question for the masked taxels with its answer."""
    line = f"calibration 0: {CALIBRATION}".encode()
    yield from transfer(message_id(HEARTBEAT), number, (7).to_bytes(4, "little") + bytes([1, 0, 128]))
    yield from transfer(message_id(RECORD), number, bytes(7) + bytes([2, len(line)]) + line)
    request = bytes([len(STUCK)]) + STUCK.encode() + b"\0"
    yield from transfer(service_id(client, NODE, ACCESS, True), number, request)
    yield from transfer(service_id(NODE, client, ACCESS, False), number, stuck())


def add_news(log, out):
    """Copy a log; in its middle the module gets a calibration."""
    lines = log.read_text().splitlines()
    middle = next(at for at in range(len(lines) // 2, len(lines)) if "04783B2A##" in lines[at])
    stamp, interface = lines[middle].split()[:2]
    said = [f"{stamp} {interface} {identifier:08X}##5{data.hex().upper()}" for identifier, data in news(99, 3)]
    out.write_text("\n".join([*lines[:middle], *said, *lines[middle:]]) + "\n")


class Module(threading.Thread):
    """The traffic of a log in real time, again and again, and a module that can be calibrated."""

    def __init__(self, log):
        super().__init__(daemon=True)
        self.frames = [(float(at), int(i, 16), bytes.fromhex(data)) for at, i, data in FRAME.findall(log.read_text())]
        self.server = socket.create_server(("127.0.0.1", 0))
        self.address = f"slcan:127.0.0.1:{self.server.getsockname()[1]}"
        self.commands, self.looks = [], 0

    def run(self):
        link = self.server.accept()[0]
        link.setblocking(False)
        text = b""
        try:
            while True:
                began = time.monotonic()
                for at, identifier, data in self.frames:
                    while time.monotonic() - began < at - self.frames[0][0]:
                        time.sleep(0.001)
                        try:
                            text += link.recv(4096)
                        except BlockingIOError:
                            pass
                        *lines, text = text.split(b"\r")
                        for line in lines:
                            self.hear(link, line.decode())
                    self.say(link, [(identifier, data)])
        except OSError:
            pass

    @staticmethod
    def say(link, frames):
        for identifier, data in frames:
            line = f"B{identifier:08X}{FD_LENGTHS.index(len(data)):X}{data.hex().upper()}\r"
            link.setblocking(True)
            link.sendall(line.encode())
            link.setblocking(False)

    def hear(self, link, line):
        """A request to this module, one frame long."""
        if not line.startswith("B"):
            return
        identifier, data = int(line[1:9], 16), bytes.fromhex(line[10:])
        client, port, number = identifier & 127, identifier >> 14 & 511, data[-1] & 31
        if port == COMMAND:
            self.commands.append((data[0], data[3 : 3 + data[2]].decode()))
            answer = bytes([0, 0])
        else:
            name = data[1 : 1 + data[0]].decode()
            self.looks += name == MEASUREMENT
            state = 2 if self.looks > 1 else 1
            answer = numbers([0, state, 240 * state, 480, 0, 0], 2) if name == MEASUREMENT else stuck(name)
        self.say(link, transfer(service_id(NODE, client, port, False), number, answer))
