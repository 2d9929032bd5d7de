"""Writes the two archives beside it with NumPy itself, for tests/round_trip.rs.

Run with NumPy 1.17 or later: python make.py. Stored by numpy.savez, deflated by
numpy.savez_compressed. Zip entries carry NumPy's fixed date, so the bytes repeat.
"""
import json
from pathlib import Path

import numpy as np

F, S, N = 2, 1, 70
f, s, r, c = np.indices((F, S, 32, 32))
piezo = np.where((r > 4) & (r < 27) & (c > 4) & (c < 27), (97 * r + 31 * c + 7 * f) % 4096, 0)
arrays = dict(
    piezo=piezo.astype(np.uint16),
    xl=(np.arange(S * N * 3) * 311 - 32768).reshape(S, N, 3).astype(np.int16),
    xl_end=np.array([[34], [67]], np.uint32),
    label=np.array([1, 2], np.uint8),
    slip_true=np.array([0, 12.5], np.float32),
    slip_fraction=np.array([0.1, 1], np.float32),
    displacement_mm=np.array([-0.5, 0.25], np.float32),
    meta=np.frombuffer(
        json.dumps(
            {"xl_lsb_g": 0.000488, "xl_rate_hz": 7921.5, "frame_rate_hz": 240, "object": "Tasse, weiß", "seed": 5},
            ensure_ascii=False,
        ).encode(),
        np.uint8,
    ),
)
here = Path(__file__).parent
np.savez(here / "numpy_savez.npz", **arrays)
np.savez_compressed(here / "numpy_savez_compressed.npz", **arrays)
