"""Check host-tools/eval/tests/vectors/baselines.json: what librosa, scipy and scikit-learn make of a fixed
signal and of fixed points. The Rust tests of the benchmark's detectors compare with the same file.

The reference shares nothing with the Rust code: scipy.signal.butter and lfilter, numpy.fft.rfft, librosa's
mel filters and MFCC, scikit-learn's discriminant analysis and logistic regression. All data are synthetic
and seeded.

  check_baselines.py           recompute and compare with the committed file; exit 1 if it differs
  check_baselines.py --write   write the file
"""

import json
import pathlib
import sys

import librosa
import numpy as np
import scipy
import sklearn
from scipy.signal import butter, lfilter
from sklearn.discriminant_analysis import QuadraticDiscriminantAnalysis
from sklearn.linear_model import LogisticRegression

from make_logmel_vectors import LSB_G, RATE_HZ, WINDOW, power

PATH = pathlib.Path(__file__).resolve().parents[2] / "host-tools/eval/tests/vectors/baselines.json"
SEED = 20261
FILTERS = 26
COEFFICIENTS = 13
FLOOR_G2 = 1e-7
RIDGE = 1e-6
ENDS = [40, 128, 300, 333, 366, 400, 600]
DECIMALS = 9
TOLERANCE = 1e-7


def signal(rng):
    """Gravity, sensor noise, and from the middle on slip noise below 500 Hz along one direction; LSB."""
    n = ENDS[-1]
    gravity = np.array([0.3, -0.5, 0.8]) / LSB_G
    noise = rng.normal(0, 90e-6 * np.sqrt(RATE_HZ / 2) / LSB_G, (n, 3))
    b, a = butter(1, 500.0, fs=RATE_HZ)
    slip = lfilter(b, a, rng.normal(size=n)) * (np.arange(n) > 320) * 0.05 / LSB_G
    return np.round(gravity + noise + slip[:, None] * np.array([0.6, 0.0, 0.8])).astype(int)


def mfccs(samples):
    """13 MFCC of the last 128 samples at each of ENDS."""
    mel = librosa.filters.mel(sr=RATE_HZ, n_fft=WINDOW, n_mels=FILTERS, fmin=20.0, fmax=4000.0, htk=True,
                              norm=None, dtype=np.float64)
    log_mel = np.log(mel @ power(samples * LSB_G, ENDS).T + FLOOR_G2)
    return librosa.feature.mfcc(S=log_mel, n_mfcc=COEFFICIENTS, dct_type=2, norm="ortho").T


def points(rng):
    """Two overlapping clouds of different shape in three dimensions, the first half is class 0."""
    mix = np.eye(3) + 0.4 * rng.normal(size=(2, 3, 3))
    clouds = [rng.normal(size=(40, 3)) @ mix[0], rng.normal(size=(40, 3)) @ mix[1] + [1.0, -0.5, 0.5]]
    return np.round(np.vstack(clouds), 6)


def reference():
    rng = np.random.default_rng(SEED)
    samples, x = signal(rng), points(rng)
    is_second = np.arange(len(x)) >= len(x) // 2
    qda = QuadraticDiscriminantAnalysis(priors=[0.5, 0.5], reg_param=RIDGE, solver="svd").fit(x, is_second)
    logistic = LogisticRegression(C=1.0, solver="newton-cholesky", tol=1e-12).fit(x, is_second)
    return {
        "samples": samples.tolist(),
        "ends": ENDS,
        "mfcc": mfccs(samples).tolist(),
        "points": x.tolist(),
        "log_ratio": qda.decision_function(x).tolist(),
        "weights": logistic.coef_[0].tolist(),
        "intercept": logistic.intercept_.tolist(),
    }


def written(made):
    origin = {
        "script": "tests/python/check_baselines.py",
        "synthetic": True,
        "seed": SEED,
        **{module.__name__: module.__version__ for module in (np, scipy, librosa)},
        "scikit-learn": sklearn.__version__,
        "lsb_g": LSB_G,
    }

    def text(value):
        if isinstance(value, list):
            return "[" + ",".join(map(text, value)) + "]"
        return str(value) if isinstance(value, int) else f"{value:.{DECIMALS}f}".rstrip("0").rstrip(".")

    lines = [f'"origin":{json.dumps(origin)}'] + [f'"{name}":{text(value)}' for name, value in made.items()]
    return "{" + ",\n".join(lines) + "}\n"


def main():
    made = reference()
    if "--write" in sys.argv:
        PATH.write_text(written(made))
        print(f"{PATH.name}: {PATH.stat().st_size / 1000:.0f} kB")
        return
    committed, failed = json.loads(PATH.read_text()), False
    for name, expected in made.items():
        expected, found = np.array(expected, float), np.array(committed[name], float)
        off = np.abs(found - expected).max() if found.shape == expected.shape else np.inf
        print(f"{PATH.name}: {name} {expected.shape}, off by {off:.1e} at most (allowed {TOLERANCE:.0e})")
        failed |= not off <= TOLERANCE
    sys.exit(1 if failed else 0)


if __name__ == "__main__":
    main()
