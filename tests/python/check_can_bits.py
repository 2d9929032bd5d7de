"""Bits of CAN and CAN FD frames against an encoder that shares no code with the one in Rust.

Usage: check_can_bits.py FRAMES, one frame a line as host-tools/can-sim/examples/random_frames.rs writes them.

This encoder works on whole lists of bits and computes checksums by long division of polynomials over GF(2), where the
one in Rust is a state machine with shift registers. Rules: ISO 11898-1:2015; check values of the checksums as in the
catalogue of parametrised CRC algorithms.
"""

import sys

LENGTHS = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64]
# Full polynomials, leading term included.
CRC15, CRC17, CRC21 = 0xC599, 0x3685B, 0x302899


def number_bits(value, width):
    return [int(bit) for bit in format(value, f"0{width}b")] if width else []


def remainder(bits, polynomial, width, start):
    """The message times x^width, with `start` added to its highest terms, divided by the polynomial."""
    message = int("".join(map(str, bits)) or "0", 2) << width
    message ^= start << len(bits)
    for place in range(len(bits) + width - 1, width - 1, -1):
        if message >> place & 1:
            message ^= polynomial << (place - width)
    return message


def stuff(bits):
    """The bits with stuff bits, and for each the index of the bit it stands for or follows."""
    out, owner = [], []
    for index, bit in enumerate(bits):
        out.append(bit)
        owner.append(index)
        # A stuff bit begins a run too: five means five in the stuffed stream.
        if out[-5:] == [bit] * 5:
            out.append(1 - bit)
            owner.append(index)
    return out, owner


def encode(extended, kind, identifier, dlc, data):
    fd, switch, passive = kind.startswith("fd"), "brs" in kind, int("esi" in kind)
    remote = int(kind == "remote")
    head = [0]
    if extended:
        head += number_bits(identifier >> 18, 11) + [1, 1] + number_bits(identifier & 0x3FFFF, 18) + [remote]
    else:
        head += number_bits(identifier, 11) + [remote, 0]
    if fd:
        brs = len(head) + 2
        head += [1, 0, int(switch), passive]
    else:
        head += [0, 0] if extended else [0]
    head += number_bits(dlc, 4)
    body = head + [bit for byte in data for bit in number_bits(byte, 8)]
    end = [1, 0, 1] + [1] * 7

    if not fd:
        levels = stuff(body + number_bits(remainder(body, CRC15, 15, 0), 15))[0] + end
        return levels, ["n"] * len(levels)

    levels, owner = stuff(body)
    if owner[-2:] == [len(body) - 1] * 2:
        # Five equal bits end the data field: the fixed stuff bit takes the place of this one.
        levels.pop()
        owner.pop()
    count = (len(levels) - len(body)) % 8
    gray = [[0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0], [1, 1, 1], [1, 0, 1], [1, 0, 0]][count]
    counted = gray + [sum(gray) % 2]
    polynomial, width = (CRC21, 21) if len(data) > 16 else (CRC17, 17)
    checksum = number_bits(remainder(levels + counted, polynomial, width, 1 << (width - 1)), width)
    # Stuff bits that follow BRS itself are already in the data phase.
    rates = ["d" if switch and place >= brs else "n" for place in owner]
    if switch:
        rates[owner.index(brs)] = ">"
    tail = counted + checksum
    for start in range(0, len(tail), 4):
        four = tail[start : start + 4]
        levels += [1 - levels[-1]] + four
        rates += ["d" if switch else "n"] * (1 + len(four))
    rates += ["<" if switch else "n"] + ["n"] * 9
    return levels + end, rates


def main():
    digits = [bit for byte in b"123456789" for bit in number_bits(byte, 8)]
    assert remainder(digits, CRC15, 15, 0) == 0x059E
    assert remainder(digits, CRC17, 17, 0) == 0x04F03
    assert remainder(digits, CRC21, 21, 0) == 0x0ED841

    frames = stuffed = 0
    for line in open(sys.argv[1], encoding="ascii"):
        extended, kind, identifier, dlc, data, levels, rates = line.split()
        data = b"" if data == "-" else bytes.fromhex(data)
        if kind.startswith("fd"):
            assert len(data) == LENGTHS[int(dlc)], line
        mine, my_rates = encode(extended == "1", kind, int(identifier, 16), int(dlc), data)
        if "".join(map(str, mine)) != levels or "".join(my_rates) != rates:
            sys.exit(f"{sys.argv[1]}: line {frames + 1}: the encoders disagree\n{line}{''.join(map(str, mine))}")
        frames += 1
        stuffed += len(levels)
    if frames == 0:
        sys.exit(f"{sys.argv[1]}: no frames")
    print(f"{frames} CAN frames, {stuffed} bits equal to the independent encoder's")


main()
