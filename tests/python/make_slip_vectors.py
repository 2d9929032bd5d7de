"""Frames into a receiver of slip messages and what must come of them: tests/vectors/slip_receiver.txt.

The messages are packed from the DSDL definition, the CRC bit by bit from its polynomial, the expectations by hand.
A line: arrival in microseconds, data of the frame, check, state, messages lost so far, act on slip. With --check the file
is compared.
"""

import pathlib
import struct
import sys

OUT = pathlib.Path(__file__).parents[1] / "vectors" / "slip_receiver.txt"
NODE = 42


def crc32_autosar(data):
    """Polynomial 0xF4ACFB13, low bit first."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0xC8DF352F if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


assert crc32_autosar(b"123456789") == 0x1697D06A, "check value of the CRC catalogue"


def frame(sequence, *, at=None, slip=False, invalid=0, starts=3, node=NODE, klass=1, data_id=b"slip", tail=None):
    """A frame of 64 bytes; its tick was at `at` microseconds of the sender."""
    at = 1_000_000 + sequence * 4167 if at is None else at
    flags = klass | slip << 2 | (klass == 2) << 3 | 2 << 4
    head = at.to_bytes(7, "little") + struct.pack("<IBBBBHB", sequence, flags, invalid, 4, starts, 0xBEEF, 200)
    contact = struct.pack("<BIHHbB", 0, 3_857_490 | 942 << 22, 0x1EFF, 0x0102, -90, 250)
    body = head + struct.pack("<4h", -32768, 0, 32767, -256) + contact * 3
    body += struct.pack("<I", crc32_autosar(data_id + bytes([node]) + body))
    return body + bytes([0xE0 | sequence % 32 if tail is None else tail])


def flipped(data, *bits):
    """With these bits of it changed."""
    data = bytearray(data)
    for bit in bits:
        data[bit // 8] ^= 1 << bit % 8
    return bytes(data)


def main():
    lines, period, start = [], 4167, 50_000_000

    def line(tick, data, check, state, lost=0, act=0, late=300):
        lines.append(f"{start + tick * period + late},{data.hex()},{check},{state},{lost},{act}")

    line(0, frame(0), "ok", "starting")
    line(1, frame(1, slip=True), "ok", "starting")
    line(2, frame(2, slip=True), "ok", "valid", act=1)
    line(3, frame(2, slip=True), "repeated", "valid", act=1)
    line(3, frame(3), "ok", "valid", late=310)
    line(4, flipped(frame(4, slip=True), 90), "error", "valid")
    line(4, flipped(frame(4, slip=True), 0, 90, 503), "error", "valid", late=310)
    line(4, frame(4, node=43), "error", "valid", late=320)
    line(4, frame(4, data_id=b"pils"), "error", "valid", late=330)
    line(4, frame(4, klass=3), "error", "valid", late=340)
    line(4, frame(4, tail=0xA0), "error", "valid", late=350)
    line(4, frame(4)[:-1], "error", "valid", late=360)
    line(4, b"", "error", "valid", late=370)
    line(6, frame(6, slip=True), "some lost", "valid", 2, act=1)
    line(6, frame(5), "wrong sequence", "valid", 2, act=1, late=310)
    line(7, frame(7, invalid=4, slip=True), "ok", "invalid", 2)
    line(8, frame(8, invalid=2, slip=True), "ok", "starting", 2)
    line(9, frame(9), "ok", "valid", 2)
    line(10, frame(10, invalid=6), "ok", "invalid", 2)
    line(11, frame(11), "ok", "valid", 2)
    line(14, frame(12), "ok", "valid", 2, late=200)
    line(18, frame(13), "delayed", "no data", 2)
    line(18, frame(18), "ok", "starting", 2, late=310)
    line(19, frame(19), "ok", "starting", 2)
    line(20, frame(20, slip=True), "ok", "valid", 2, act=1)
    # Without a message for longer than three periods nothing is believed; numbers may lie far apart then.
    line(24, flipped(frame(24), 7), "error", "no data", 2)
    line(300, frame(300), "ok", "starting", 2)
    line(301, frame(320), "wrong sequence", "starting", 2)
    line(301, frame(301), "ok", "starting", 2, late=310)
    line(302, frame(302), "ok", "valid", 2)
    # A restart that the module counts, and one after its supply was gone.
    line(303, frame(0, at=1000, starts=4), "ok", "starting", 2)
    line(304, frame(1, at=5167, starts=4), "ok", "starting", 2)
    line(305, frame(2, at=9334, starts=4), "ok", "valid", 2)
    line(306, frame(303), "wrong sequence", "valid", 2)
    line(400, frame(0, at=900, starts=4), "ok", "starting", 2)
    # The number wraps.
    line(401, frame(0xFFFFFFFF, at=2000, starts=99), "ok", "starting", 2)
    line(402, frame(0, at=6167, starts=99), "ok", "starting", 2)
    line(404, frame(2, at=10334 + 4167, starts=99), "some lost", "valid", 3)
    text = "\n".join(lines) + "\n"
    if sys.argv[1:] == ["--check"]:
        sys.exit(0 if OUT.read_text() == text else f"{OUT} is not what this script makes")
    OUT.write_text(text)


if __name__ == "__main__":
    main()
