from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any

import numpy as np
import xarray
from numpy.typing import NDArray

__all__ = ["Contact", "Episode", "Log", "Output", "Pipeline", "Raw", "Receiver", "Slip", "SlipReceiver", "command",
           "live", "pressure_table_kpa", "run"]

class Episode:
    """A stretch of sensor data in an .npz file."""

    @staticmethod
    def read(path: str | PathLike[str]) -> Episode:
        """Raises ValueError that names file, field, index and rule."""
    @staticmethod
    def from_bytes(data: bytes, name: str = "episode") -> Episode:
        """The content of an .npz file, as `numpy.savez` makes it; errors call it `name`."""
    def write(self, path: str | PathLike[str]) -> None:
        """The same episode gives the same bytes."""
    def to_xarray(self) -> xarray.Dataset:
        """Named axes, units and coordinates: `pressure` in kPa, `acceleration` in g, what is known of the truth.

        Needs xarray: pip install slipsense[xarray].
        """

    frames: int
    sensors: int
    meta: str  #: JSON text.
    piezo: NDArray[np.uint16]  #: [F, S, 32, 32], counts of 12 bits.
    xl: NDArray[np.int16]  #: [S, N, 3], in units of `xl_lsb_g` of the metadata.
    xl_end: NDArray[np.uint32]  #: [F, S], samples available at the tick, exclusive end.
    label: NDArray[np.uint8] | None  #: [F]: 0 no contact, 1 no slip, 2 slip.
    slip_true: NDArray[np.float32] | None  #: [F], slip speed in mm/s, of a simulator.
    slip_fraction: NDArray[np.float32] | None  #: [F], share of the load that slips, of a simulator.
    displacement_mm: NDArray[np.float32] | None  #: [F], of a test stand.

def pressure_table_kpa() -> NDArray[np.float32]:
    """Pressure of each of the 4096 counts by the nominal film, kPa: `pressure_table_kpa()[episode.piezo]`.

    A pad whose gain was measured (`slipsense calibrate --newton`) reads right by it.
    """

def command(*arguments: str | PathLike[str]) -> None:
    """Run the command `slipsense`; results go to standard output. Raises ValueError with its line of error."""

def run(episode: Episode, model: bytes | None = None) -> dict[str, NDArray[Any]]:
    """All frames through the pipeline, as in the predictions.npz of `slipsense run`.

    Of F frames and S sensors: `class` uint8 [F] (0 no contact, 1 contact without slip, 2 slip), `logits` int32 [F, 3]
    (1/1024 nat), `log_odds` int32 [F] (of slip, 1/1024 nat; the least number where no pad is touched), `slip` (the flag to
    act on) and `may_begin` uint8 [F], `logmel` (natural log of g²) and `logmel_std` float32 [F, S, 16].
    `model`: content of a .slipnet file; the bundled one if None.
    """

class Contact:
    """The contact on one pad. Rows and columns count taxels from the pad's corner (0, 0)."""

    health: int  #: bits, see slipsense.SensorContact in src/wire/dsdl
    sum: int  #: of the counts
    area: int  #: taxels in contact
    centroid_row: float
    centroid_col: float
    axis_deg: int  #: direction of the long axis, −90 to 89
    elongation: float  #: 1 − short axis / long axis

class Output:
    """The result of one frame."""

    class_index: int
    slip: bool  #: the flag to act on
    may_begin: bool
    invalid: int  #: bits: why `slip` must not be believed, see slipsense.Slip in src/wire/dsdl
    degraded: int  #: bits: what makes it worse
    logits_q10: NDArray[np.int32]
    log_odds_q10: int | None  #: of slip, what `slip` is decided on; None where no pad is touched
    contact: list[Contact]
    logmel_std: NDArray[np.float32]

class Pipeline:
    """The signal path of one module with 1 to 3 sensors; it remembers what came before."""

    sensors: int
    def __init__(self, sensors: int, model: bytes | None = None) -> None: ...
    def step(
        self,
        parts: Sequence[
            tuple[NDArray[np.uint16] | None, NDArray[np.int16] | None]
            | tuple[NDArray[np.uint16] | None, NDArray[np.int16] | None, int]
        ],
    ) -> Output:
        """Take one frame in: of each sensor its counts [32, 32] and the samples [n, 3] since the frame before.

        A third item is the index of the sample after the last. Where it shows that samples are missing, the
        accelerometer's window starts again, as in the firmware. Without it there is no gap. None: that part is
        missing. Raises ValueError that names sensor and rule.
        """

class Slip:
    """The decision of one frame, as sent."""

    timestamp_us: int
    sequence: int
    class_index: int
    slip: bool  #: the flag to act on where `invalid` is 0
    may_begin: bool
    locked: bool
    invalid: int  #: bits: why `slip` must not be believed, see slipsense.Slip in src/wire/dsdl
    degraded: int  #: bits: what makes it worse
    starts: int
    configuration: int
    late_frames: int
    logits_q8: NDArray[np.int16]
    log_odds_q8: int
    contact: list[Contact]

class Raw:
    """What one sensor delivered for one frame, as sent."""

    timestamp_us: int
    sequence: int
    sensor: int
    health: int
    piezo: NDArray[np.uint16] | None  #: None where no taxel was sent
    region: tuple[int, int, int, int]  #: first row, rows, first column, columns of what was sent; the others read 0
    xl: NDArray[np.int16] | None
    xl_end: int
    xl_dropped: int  #: samples of this frame, older than `xl`, that did not fit; stays at 255

class Receiver:
    """Puts the CAN frames of one module together."""

    errors: int  #: frames that fitted nothing, and messages that could not be read
    def __init__(self, node: int = 42) -> None: ...
    missed: int
    def accept(self, can_id: int, data: bytes) -> Slip | Raw | None:
        """The message that this frame completes. Raises ValueError for what is no CAN FD frame of 29 bits."""

class SlipReceiver:
    """Checks the slip messages of one module. Times are microseconds of one clock that never goes back."""

    lost: int
    message: Slip | None  #: the one accepted last
    def __init__(self, node: int = 42) -> None: ...
    def receive(self, data: bytes, now_us: int) -> str:
        """Data of a slip frame: "ok", "some lost", "repeated", "wrong sequence", "delayed" or "error"."""
    def state(self, now_us: int) -> str:
        """May the flag be believed? "no data", "starting", "valid" or "invalid"."""
    def slip(self, now_us: int) -> bool:
        """The flag is up and may be believed."""

class Log(Iterator[tuple[int, Slip | Raw]]):
    """Messages of a candump log: time of the log in microseconds, message."""

    def __init__(self, path: str | PathLike[str], node: int = 42) -> None: ...
    errors: int
    missed: int
    def __iter__(self) -> Log: ...
    def __next__(self) -> tuple[int, Slip | Raw]: ...

def live(bus: Any, node: int = 42, timeout: float | None = None) -> Iterator[Slip | Raw]:
    """Messages of a module, as they come from a python-can bus.

    Raises TimeoutError when the module sent none for `timeout` seconds.
    """
