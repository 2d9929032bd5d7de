"""Make the committed integer tables of the kernels: src/features/tables.rs, src/features/cmsis/tables.rs,
src/net/tables.rs and src/drivers/decimate_table.rs.

Every entry is floor(x * 2^q + 1/2) of a value taken with 60 decimal digits, so no machine's floating
point has a say in it. Needs mpmath (tests/python/requirements.txt) and rustfmt.

  make_tables.py           write the files
  make_tables.py --check   compare with the committed files; exit 1 and name each that differs
"""

import pathlib
import subprocess
import sys

from mpmath import mp, mpf

mp.dps = 60

ROOT = pathlib.Path(__file__).resolve().parents[2]
XL_RATE_HZ = 8000
HIGHPASS_HZ = 10
WINDOW = 128
MEL_BINS = 16
MEL_LOW_HZ, MEL_HIGH_HZ = 20, 4000

HIGHPASS_BITS = 32
HANN_BITS = 31
MEL_BITS = 24
LN_BITS = 24
LN_SEGMENTS = 128
EXP2_BITS = 15
EXP2_STEPS = 1024

# The half-band filter of an accelerometer at twice the rate: a sinc under a Kaiser window.
DECIMATE_BITS = 15
DECIMATE_TAPS = 47
DECIMATE_STOP_DB = 60


def fixed(x, bits):
    """The project's rounding rule, ties towards plus infinity."""
    return int(mp.floor(mpf(x) * 2**bits + mpf(1) / 2))


def grouped(n):
    """A Rust integer literal with its digits in threes."""
    return f"{n:,}".replace(",", "_")


def literal(value):
    if isinstance(value, (list, tuple)):
        left, right = "[]" if isinstance(value, list) else "()"
        return left + ", ".join(literal(v) for v in value) + right
    return str(value)  # without separators, so that rustfmt packs rows


def highpass():
    """b0, a1, a2 of the bilinear second-order Butterworth high-pass with a prewarped corner."""
    k = mp.tan(mp.pi * HIGHPASS_HZ / XL_RATE_HZ)
    norm = 1 + mp.sqrt(2) * k + k * k
    b0, a1, a2 = 1 / norm, 2 * (k * k - 1) / norm, (1 - mp.sqrt(2) * k + k * k) / norm
    return b0, a1, a2


def highpass_gain():
    """Sum of |h[n]|: the largest output per unit of input. The tail is below 1e-30 after 2 s."""
    b0, a1, a2 = highpass()
    total, y1, y2 = mpf(0), mpf(0), mpf(0)
    for n in range(2 * XL_RATE_HZ):
        x = {0: b0, 1: -2 * b0, 2: b0}.get(n, mpf(0))
        y1, y2 = x - a1 * y1 - a2 * y2, y1
        total += abs(y1)
    return total


def fixed_i32(x, bits):
    """As fixed; 1 with 31 fraction bits becomes the largest i32, 2^-31 less."""
    return min(fixed(x, bits), 2**31 - 1)


def twiddle(k, n, bits, gain=1):
    """Cosine and sine of 2 pi k / n, times gain."""
    angle = 2 * mp.pi * k / n
    return [fixed_i32(gain * mp.cos(angle), bits), fixed_i32(gain * mp.sin(angle), bits)]


def mel_segments():
    """Bins between neighbouring edges of the HTK-mel grid and their weight in the rising triangle."""

    def mel(hz):
        return 2595 * mp.log10(1 + mpf(hz) / 700)

    low, high = mel(MEL_LOW_HZ), mel(MEL_HIGH_HZ)
    edges = [700 * (mp.power(10, (low + (high - low) * i / (MEL_BINS + 1)) / 2595) - 1) for i in range(MEL_BINS + 2)]
    lengths, rising = [], []
    for left, right in zip(edges, edges[1:]):
        bins = [mpf(k) * XL_RATE_HZ / WINDOW for k in range(1, WINDOW // 2)]
        inside = [hz for hz in bins if left <= hz < right]
        lengths.append(len(inside))
        rising += [fixed((hz - left) / (right - left), MEL_BITS) for hz in inside]
    # Bin 0 (0 Hz) lies below the first edge, the last bin (4 kHz) on the last edge, where the weight is 0.
    assert len(rising) == WINDOW // 2 - 1 and min(lengths) >= 1
    return lengths, rising


HEADER = """//! {about}
//!
//! Written by `tests/python/make_tables.py` with 60 decimal digits, every entry rounded as
//! `floor(x + 1/2)`; `make_tables.py --check` compares. Not to be edited by hand.

"""


def features_tables():
    b0, a1, a2 = highpass()
    difference, y1, y2 = (fixed(c, HIGHPASS_BITS) for c in (b0 - 1, -a1 - 2, 1 - a2))
    hann = [fixed_i32((1 - mp.cos(2 * mp.pi * n / WINDOW)) / 2, HANN_BITS) for n in range(WINDOW)]
    radix4 = [[twiddle(i * j, WINDOW // 2, 30) for i in (1, 2, 3)] for j in range(WINDOW // 8)]
    gain = mp.sqrt(mpf(4) / 3)
    with_gain = [(fixed(gain, 30), [twiddle(i * j, WINDOW // 8, 30, gain) for i in (1, 2, 3)]) for j in range(WINDOW // 32)]
    cosines = [twiddle(k, WINDOW, 31)[0] for k in range(1, WINDOW // 4)]
    lengths, rising = mel_segments()
    ln = [fixed(mp.log(1 + mpf(i) / LN_SEGMENTS), LN_BITS) for i in range(LN_SEGMENTS + 1)]
    parts = [
        HEADER.format(about="Constants of the front end."),
        "use super::highpass::HighPass;\n\n",
        f"/// Butterworth, second order, {HIGHPASS_HZ} Hz at {XL_RATE_HZ} Hz. "
        f"The sum of its absolute impulse response is {mp.nstr(highpass_gain(), 6)}.\n",
        f"pub const HIGHPASS: HighPass = HighPass {{ difference_q{HIGHPASS_BITS}: {grouped(difference)}, "
        f"y1_q{HIGHPASS_BITS}: {grouped(y1)}, y2_q{HIGHPASS_BITS}: {grouped(y2)} }};\n\n",
        f"/// Periodic Hann window, `(1 - cos(2 pi n / {WINDOW})) / 2`, Q{HANN_BITS}; the peak is 2^-31 less than 1.\n",
        f"pub static HANN_Q{HANN_BITS}: [i32; {WINDOW}] = {literal(hann)};\n\n",
        f"/// A gain of sqrt(4/3), and `exp(-2 pi i j m / {WINDOW // 8})` times that as cosine and sine, `[re, -im]`, Q30: one row per j,\n"
        f"/// m = 1, 2, 3.\n",
        f"pub static GAIN_TWIDDLE_16_Q30: [(i32, [[i32; 2]; 3]); {len(with_gain)}] = {literal(with_gain)};\n\n",
        f"/// `exp(-2 pi i j m / {WINDOW // 2})` as cosine and sine, `[re, -im]`, Q30: one row per j, m = 1, 2, 3.\n",
        f"pub static TWIDDLE_64_Q30: [[[i32; 2]; 3]; {len(radix4)}] = {literal(radix4)};\n\n",
        f"/// `cos(2 pi k / {WINDOW})`, Q31, for k = 1 to {len(cosines)}; backwards, the sine.\n",
        f"pub const COS_{WINDOW}_Q31: [i32; {len(cosines)}] = {literal(cosines)};\n\n",
        f"/// FFT bins between neighbouring edges of the mel grid, from bin 1 on "
        f"({MEL_BINS + 2} edges, {MEL_LOW_HZ} to {MEL_HIGH_HZ} Hz).\n",
        f"pub static MEL_SEGMENT_BINS: [u8; {len(lengths)}] = {literal(lengths)};\n\n",
        f"/// Weight of each bin, from bin 1 on, in the triangle that rises over its segment; Q{MEL_BITS}. "
        f"The triangle that\n/// falls over it has the rest of 1.\n",
        f"pub static MEL_RISING_Q24: [u32; {len(rising)}] = {literal(rising)};\n\n",
        f"/// `ln(1 + i / {LN_SEGMENTS})`, Q{LN_BITS}.\n",
        f"pub static LN_Q24: [u32; {len(ln)}] = {literal(ln)};\n\n",
        f"/// `ln 2`, Q{LN_BITS}.\n",
        f"pub const LN_2_Q24: u32 = {grouped(fixed(mp.log(2), LN_BITS))};\n",
    ]
    return "".join(parts)


def cmsis_twiddle(x):
    """CMSIS-DSP's twiddleCoef_64_q31 is neither rounded nor cut off; this gives every one of its 96 entries."""
    return min(int(mp.floor(x * 2**31 + mpf(1) / 32)), 2**31 - 1)


def cmsis_tables():
    window, half = WINDOW, WINDOW // 2
    gain = mp.sqrt(mpf(2) / 3)
    hann = [fixed(gain * (1 - mp.cos(2 * mp.pi * n / window)) / 2, 31) for n in range(window)]
    cosines = [cmsis_twiddle(mp.cos(2 * mp.pi * k / half)) for k in range(half // 2 + 1)]
    return "".join([
        HEADER.format(about="Constants of the front end with CMSIS-DSP's FFT, and of the FFT itself, by formula.\n//! "
                            "\n//! That they are those of the library, `cargo xtask test --only qemu-cmsis` shows."),
        f"/// Periodic Hann window, `(1 - cos(2 pi n / {window})) / 2`, times sqrt(2/3); Q31.\n",
        f"pub static HANN_GAIN_Q31: [i32; {window}] = {literal(hann)};\n\n",
        f"/// `cos(2 pi k / {half})`, Q31, for k = 0 to {half // 2}. As in the library, each is `floor(x + 1/32)`.\n",
        f"pub static COS_{half}_Q31: [i32; {len(cosines)}] = {literal(cosines)};\n",
    ])


def net_tables():
    exp2 = [fixed(mp.power(2, -mpf(f) / EXP2_STEPS), EXP2_BITS) for f in range(EXP2_STEPS)]
    return "".join([
        HEADER.format(about="The exponential of the softmax."),
        f"/// `2^(-f / {EXP2_STEPS})`, Q{EXP2_BITS}.\n",
        f"pub static EXP2_Q15: [u16; {EXP2_STEPS}] = {literal(exp2)};\n",
    ])


def half_band():
    """The coefficients at offsets 1, 3, 5, ... from the centre, whose own is 1/2; the even ones are 0."""
    side = (DECIMATE_TAPS - 1) // 2
    beta = mpf("0.1102") * (DECIMATE_STOP_DB - mpf("8.7"))
    return [mp.sin(mp.pi * n / 2) / (mp.pi * n) * mp.besseli(0, beta * mp.sqrt(1 - (mpf(n) / side) ** 2)) / mp.besseli(0, beta)
            for n in range(1, side + 1, 2)]


def decimate_table():
    taps = [fixed(c, DECIMATE_BITS) for c in half_band()]
    return "".join([
        HEADER.format(about="The half-band filter of the decimation by 2."),
        f"/// Coefficients at offsets 1, 3, 5, ... from the centre of the {DECIMATE_TAPS} taps, Q{DECIMATE_BITS}: a sinc under a Kaiser\n"
        f"/// window for {DECIMATE_STOP_DB} dB. The centre is 1/2, the even offsets are 0.\n",
        f"pub static HALF_BAND_Q{DECIMATE_BITS}: [i32; {len(taps)}] = {literal(taps)};\n",
    ])


def rustfmt(source):
    done = subprocess.run(["rustfmt", "--edition", "2024", "--emit", "stdout"], input=source, text=True,
                          cwd=ROOT, capture_output=True)
    if done.returncode != 0:
        sys.exit(f"rustfmt refused a table: {done.stderr.strip()}")
    return done.stdout


def main():
    failed = False
    for name, make in (
        ("src/features/tables.rs", features_tables),
        ("src/features/cmsis/tables.rs", cmsis_tables),
        ("src/net/tables.rs", net_tables),
        ("src/drivers/decimate_table.rs", decimate_table),
    ):
        path, text = ROOT / name, rustfmt(make())
        if "--check" not in sys.argv:
            path.write_text(text)
            print(f"{name}: written")
        elif not path.exists() or path.read_text() != text:
            print(f"{name}: differs from what make_tables.py makes", file=sys.stderr)
            failed = True
        else:
            print(f"{name}: as made")
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
