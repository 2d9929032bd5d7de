"""Make tests/vectors/logmel_vectors.json: accelerometer signals and their log-mel in float64.

The reference shares nothing with the Rust front end: scipy.signal.butter and lfilter, numpy.fft.rfft,
scipy's periodic Hann window, librosa's mel filters. All signals are synthetic, seeded and whole LSB.

  make_logmel_vectors.py           write the vectors
  make_logmel_vectors.py --check   recompute and compare with the committed file; exit 1 if it differs

Both first rotate signals by random rotations and fail if the reference changes by 1e-9 nat or more.
"""

import json
import pathlib
import sys

import librosa
import numpy as np
import scipy
from scipy.signal import butter, lfilter, lfilter_zi
from scipy.spatial.transform import Rotation

PATH = pathlib.Path(__file__).resolve().parents[1] / "vectors" / "logmel_vectors.json"
SEED = 20260
RATE_HZ = 8000
WINDOW = 128
FLOOR_LSB2 = 1.0
EPSILON_NAT2 = 1e-4
LSB_G = 0.000488
NOISE_G_RTHZ = 90e-6
DECIMALS = 8
TOLERANCE = 1e-7

HANN = scipy.signal.get_window("hann", WINDOW, fftbins=True)
MEL = librosa.filters.mel(sr=RATE_HZ, n_fft=WINDOW, n_mels=16, fmin=20.0, fmax=4000.0, htk=True, norm=None,
                          dtype=np.float64)
B, A = butter(2, 10.0, btype="highpass", fs=RATE_HZ)


def power(samples, ends):
    """Axis-summed power spectrum of the window before each end; zeros before the first sample. samples: (n, 3)."""
    # The filter starts as if the first sample had been there forever.
    filtered, _ = lfilter(B, A, samples, axis=0, zi=lfilter_zi(B, A)[:, None] * samples[0])
    padded = np.vstack([np.zeros((WINDOW, 3)), filtered])
    spectra = (np.fft.rfft(padded[end : end + WINDOW] * HANN[:, None], axis=0) for end in ends)
    return np.array([(np.abs(spectrum) ** 2).sum(axis=1) for spectrum in spectra])


def log_mel(samples, hops):
    """At the end of each hop, of power in LSB²."""
    return np.log(np.maximum(power(samples, np.cumsum(hops)) @ MEL.T, FLOOR_LSB2))


def standardised(ln_power):
    mean = ln_power.mean(axis=1, keepdims=True)
    return (ln_power - mean) / np.sqrt(ln_power.var(axis=1, keepdims=True) + EPSILON_NAT2)


def hops_of(frames, jitter=None):
    """33, 33, 34 as the tick of 240 Hz cuts 8 kHz; with jitter, each off by up to three samples."""
    ends = [(k + 1) * RATE_HZ // 240 for k in range(frames)]
    hops = np.diff([0, *ends])
    return hops if jitter is None else hops + jitter.integers(-3, 4, frames)


def whole(signal):
    return np.clip(np.floor(np.asarray(signal) + 0.5), -32768, 32767).astype(np.int64)


def sensor_noise(rng, n, g_rthz=NOISE_G_RTHZ):
    return rng.normal(0, g_rthz * np.sqrt(RATE_HZ / 2) / LSB_G, (n, 3))


def unit(rng):
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def slip_noise(rng, n, rms_g, roll_off_hz):
    """Asperity noise: white through a first-order roll-off, along one direction."""
    b, a = butter(1, roll_off_hz, fs=RATE_HZ)
    noise = lfilter(b, a, rng.normal(size=n + 500))[500:]
    return noise[:, None] / noise.std() * rms_g / LSB_G * unit(rng)


def tones(frequencies, amplitude, n, rng):
    t = np.arange(n) / RATE_HZ
    part = n // len(frequencies)
    signal = np.zeros(n)
    for i, f in enumerate(frequencies):
        here = slice(i * part, n if i == len(frequencies) - 1 else (i + 1) * part)
        signal[here] = amplitude * np.sin(2 * np.pi * f * t[here])
    return signal[:, None] * unit(rng)


def highpass_worst(n):
    """Full-scale input whose signs follow the impulse response backwards: the largest output there is."""
    impulse = np.zeros(n)
    impulse[0] = 1.0
    h = lfilter(B, A, impulse)[::-1]
    return np.where(h[:, None] * np.array([1, -1, 1]) >= 0, 32767, -32768)


def signals():
    rng = np.random.default_rng(SEED)
    made = []

    def add(name, about, frames, make, jitter=False):
        hops = hops_of(frames, rng if jitter else None)
        made.append((name, about, hops, whole(make(int(hops.sum())))))

    edges = librosa.mel_frequencies(n_mels=18, fmin=20.0, fmax=4000.0, htk=True)
    gravity = unit(rng) / LSB_G
    time = lambda n: np.arange(n)[:, None] / RATE_HZ
    add("quiet_slip", "4 mg of slip noise below 200 Hz over 90 ug/rtHz of sensor noise and gravity", 30,
        lambda n: gravity + slip_noise(rng, n, 0.004, 200.0) + sensor_noise(rng, n), jitter=True)
    add("sensor_noise", "sensor noise and gravity alone", 12, lambda n: gravity + sensor_noise(rng, n), jitter=True)
    add("quiet_part", "30 ug/rtHz, the quietest part considered, and gravity", 12,
        lambda n: gravity + sensor_noise(rng, n, 30e-6))
    add("quiet_over_motion", "quiet slip beside 12 Hz motion at 90 % of full scale", 18,
        lambda n: 29500 * np.sin(2 * np.pi * 12 * time(n)) * unit(rng) + slip_noise(rng, n, 0.004, 200.0)
        + sensor_noise(rng, n))
    add("full_scale_noise", "uniform over all of int16", 12, lambda n: rng.integers(-32768, 32768, (n, 3)), True)
    add("full_scale_sweep", "sine sweep 10 Hz to 4 kHz at full scale, a third of a turn between axes", 18,
        lambda n: 32767 * np.sin(2 * np.pi * 10 * n / RATE_HZ / np.log(400) * (400 ** (time(n) * RATE_HZ / n) - 1)
                                 + np.array([0, 2.1, 4.2])))
    add("impulse", "one full-scale sample on x in silence", 9,
        lambda n: np.where(np.arange(n) == 150, 32767, 0)[:, None] * np.array([1, 0, 0]))
    add("edge_tones_low", "tones on mel edges 0 to 5, 12 frames' worth of time, 8000 LSB", 18,
        lambda n: tones(edges[0:6], 8000, n, rng))
    add("edge_tones_middle", "tones on mel edges 6 to 11, 300 LSB", 18, lambda n: tones(edges[6:12], 300, n, rng))
    add("edge_tones_high", "tones on mel edges 12 to 17, 20 LSB", 18, lambda n: tones(edges[12:18], 20, n, rng))
    add("gravity_flip", "gravity, then at once the opposite", 15,
        lambda n: gravity * np.where(np.arange(n) < 200, 1, -1)[:, None] + np.zeros((n, 3)))
    add("silence", "zeros", 5, lambda n: np.zeros((n, 3)))
    add("gravity_alone", "a constant: silent from the first sample on", 5, lambda n: gravity + np.zeros((n, 3)))
    add("clipped_square", "square wave of 100 Hz between the extremes, clipped", 12,
        lambda n: 60000 * np.sign(np.sin(2 * np.pi * 100 * time(n) + 0.1)) * np.ones(3))
    add("alternating_extremes", "32767 and -32768 in turn on every axis", 9,
        lambda n: np.where(np.arange(n) % 2 == 0, 32767, -32768)[:, None] * np.ones(3))
    add("one_lsb", "each sample -1, 0 or 1: rounding noise of the part, nearest to the floor", 15,
        lambda n: rng.integers(-1, 2, (n, 3)), jitter=True)
    add("highpass_worst", "the full-scale input that drives the high-pass furthest", 27, highpass_worst)
    return made


def rotation_change():
    """Largest change of the reference under random rotations of unrounded signals, nat."""
    rng = np.random.default_rng(SEED + 1)
    hops, worst = hops_of(12), 0.0
    n = int(hops.sum())
    for signal in (sensor_noise(rng, n), 20000 * rng.normal(size=(n, 3)),
                   slip_noise(rng, n, 0.03, 1000.0) + slip_noise(rng, n, 0.01, 3000.0) + sensor_noise(rng, n)):
        before = log_mel(signal, hops)
        for rotation in Rotation.random(100, rng=rng):
            worst = max(worst, np.abs(log_mel(rotation.apply(signal), hops) - before).max())
    return worst


def rows(array, form):
    return ",\n".join("[" + ",".join(form(v) for v in row) + "]" for row in array)


def written(made, results):
    """JSON with one frame or one axis per line."""
    number = lambda v: f"{v:.{DECIMALS}f}".rstrip("0").rstrip(".")
    origin = {
        "script": "tests/python/make_logmel_vectors.py",
        "synthetic": True,
        "seed": SEED,
        **{module.__name__: module.__version__ for module in (np, scipy, librosa)},
        "floor_lsb2": FLOOR_LSB2,
        "epsilon_nat2": EPSILON_NAT2,
    }
    parts = []
    for (name, about, hops, samples), (ln_power, standard) in zip(made, results):
        parts.append(
            f'{{"name":"{name}","about":"{about}",\n"hops":[{",".join(map(str, hops))}],\n'
            f'"axes":[\n{rows(samples.T, str)}],\n"ln_power":[\n{rows(ln_power, number)}],\n'
            f'"standardised":[\n{rows(standard, number)}]}}')
    return f'{{"origin":{json.dumps(origin)},\n"signals":[\n' + ",\n".join(parts) + "]}\n"


def compare(made, results):
    """Complaints about the committed file, as lines."""
    committed = {signal["name"]: signal for signal in json.loads(PATH.read_text())["signals"]}
    if list(committed) != [name for name, *_ in made]:
        return [f"signals are {list(committed)}"]
    complaints = []
    for (name, _, hops, samples), (ln_power, standard) in zip(made, results):
        signal = committed[name]
        if signal["hops"] != list(hops) or signal["axes"] != samples.T.tolist():
            complaints.append(f"{name}: the samples differ")
            continue
        for field, expected in (("ln_power", ln_power), ("standardised", standard)):
            off = np.abs(np.array(signal[field]) - expected).max()
            if not off <= TOLERANCE:
                complaints.append(f"{name}: {field} is off by {off:.2e}")
    return complaints


def main():
    change = rotation_change()
    print(f"float64 reference under 300 random rotations: changes by {change:.1e} nat at most (allowed: 1e-9)")
    if not change < 1e-9:
        sys.exit("the reference is not invariant to rotation")

    made = signals()
    ln_powers = [log_mel(samples.astype(float), hops) for _, _, hops, samples in made]
    results = [(ln_power, standardised(ln_power)) for ln_power in ln_powers]
    if "--check" in sys.argv:
        complaints = compare(made, results)
        for line in complaints:
            print(f"{PATH.name}: {line}", file=sys.stderr)
        print(f"{PATH.name}: {len(made)} signals compared")
        sys.exit(1 if complaints else 0)
    PATH.write_text(written(made, results))
    print(f"{PATH.name}: {len(made)} signals, {PATH.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
