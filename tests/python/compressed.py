"""A second decoder of slipsense.RawCompressed, from the description in src/wire/compress/mod.rs.

Only the frequencies are read from the Rust source: they are data.
"""

import binascii
import bisect
import pathlib
import re

import numpy as np
import pycyphal.dsdl

SOURCE = pathlib.Path(__file__).resolve().parents[2] / "src" / "wire" / "compress" / "tables.rs"
CODED, REGION, NO_TAXELS = 1, 2, 4
CHECK_AT = 20
TOTAL_BITS = 12
UNIT_BITS = 16
STEADY = 15


def _tables(name):
    """For each context the sums of the frequencies before each symbol, and before the end."""
    text = SOURCE.read_text(encoding="utf-8")
    body = re.search(rf"const {name}: .*?= \[\n(.*?)\n\];", text, re.S)[1]
    rows = re.findall(r"\[([^\]]*)\]", body)
    return [np.concatenate([[0], np.cumsum([int(n) for n in row.split(",")])]).tolist() for row in rows]


TAXELS, XL = _tables("TAXELS"), _tables("XL")


class _Decoder:
    def __init__(self, data):
        self.data, self.at, self.range, self.offset = data, 0, (1 << 32) - 1, 0
        self._unit()
        self._unit()

    def _unit(self):
        unit = int.from_bytes(self.data[self.at : self.at + 2], "little")
        self.at += 2
        self.offset = self.offset << UNIT_BITS | unit

    def _narrow(self, share, start, frequency):
        self.offset -= share * start
        self.range = share * frequency
        if self.range < 1 << UNIT_BITS:
            self.range <<= UNIT_BITS
            self._unit()

    def bits(self, count):
        share = self.range >> count
        value = self.offset // share
        self._narrow(share, value, 1)
        return value

    def signed(self, sums):
        share = self.range >> TOTAL_BITS
        symbol = bisect.bisect_right(sums, self.offset // share) - 1
        self._narrow(share, sums[symbol], sums[symbol + 1] - sums[symbol])
        value = symbol
        if symbol >= 16:
            extra = 3 + (symbol - 16) // 2
            value = (2 + symbol % 2) << extra
            value += self.bits(extra)
        return -(value + 1) // 2 if value % 2 else value // 2


def _context(number, tables):
    """Half octaves: 0, 1, 2, 3-4, 5-6, 7-10, 11-14, ..."""
    top = (number + 1).bit_length() - 1
    half = (number + 1) >> (top - 1) & 1 if top else 0
    return tables[min(2 * top - 1 + half if top else 0, len(tables) - 1)]


def _wrap(value):
    return (value + 0x8000) % 0x10000 - 0x8000


def _samples(decoder, count):
    samples = np.zeros((count, 3), np.int64)
    for axis in range(3 if count else 0):
        half_steps, scale = decoder.bits(2) - 1, decoder.bits(4)
        last, step, size = _wrap(decoder.bits(16)), 0, 4 << scale
        samples[0, axis] = last
        if scale == STEADY:
            samples[:, axis] = last
            continue
        for index in range(1, count):
            guess = last + (half_steps * step >> 1)
            folded = decoder.signed(_context(size, XL))
            now = _wrap(guess + folded)
            folded = 2 * folded if folded >= 0 else -2 * folded - 1
            size += folded - size // 4
            step, last = now - last, now
            samples[index, axis] = now
    return samples


def _taxels(decoder, sent):
    rows = [[0] * 33 for _ in range(33)]
    for row in range(32):
        above, here = rows[row], rows[row + 1]
        for col in np.flatnonzero(sent[row]).tolist():
            # Column col is at col + 1.
            w, nw, n = here[col], above[col], above[col + 1]
            table, guess = TAXELS[0], 0
            if w or nw or n:
                table = _context(1 + abs(w - n) + (w + n) // 16, TAXELS)
                guess = max(3 * (w + n) - 2 * nw, 0) // 4
            here[col + 1] = guess + decoder.signed(table)
    return np.array(rows)[1:, 1:]


def check(message):
    """The CRC that a message should have: of all its bytes but the two of the check."""
    data = b"".join(pycyphal.dsdl.serialize(message))
    return binascii.crc_hqx(data[CHECK_AT + 2 :], binascii.crc_hqx(data[:CHECK_AT], 0xFFFF))


def decode(message, active):
    """Counts [32, 32], which of them were sent, and samples [n, 3] of a message; the pad's taxels are `active`."""
    data, count = bytes(message.data), int(message.xl_count)
    sent = active.copy()
    if message.form & NO_TAXELS:
        sent[:] = False
    elif message.form & REGION:
        first_row, rows, first_col, cols = data[:4]
        data = data[4:]
        box = np.zeros_like(sent)
        box[first_row : first_row + rows, first_col : first_col + cols] = True
        sent &= box
    if message.form & CODED:
        decoder = _Decoder(data)
        samples = _samples(decoder, count)
        counts = _taxels(decoder, sent)
        assert decoder.at == len(data), "a decoder takes all bytes and no more"
        return counts, sent, samples
    samples = np.frombuffer(data[: 6 * count], "<i2").reshape(count, 3)
    packed = int.from_bytes(data[6 * count :], "little")
    counts = np.zeros((32, 32), np.int64)
    for index, (row, col) in enumerate(np.argwhere(sent)):
        counts[row, col] = packed >> 12 * index & 0xFFF
    return counts, sent, samples
