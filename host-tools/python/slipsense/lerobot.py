"""Episodes as a LeRobot dataset, and back.

    slipsense.lerobot.write(["a.npz", "b.npz"], "out/grasps", fps=30, task="hold the mug")
    for episode in slipsense.lerobot.read("out/grasps"):
        ...

A row of the dataset is a camera's frame: the scans of 1/fps s, the samples of the accelerometer that came with them, and
what the pipeline says of each scan. Nothing is lost: pressure in kPa and acceleration in g are float32, from which the
counts and samples are found again exactly. To put rows beside a camera's pictures, add `rows` to your own frames.
"""

import io
import itertools
import json
import os
import pathlib
import tempfile
from collections.abc import Iterable, Iterator
from typing import Any

import numpy
from numpy.typing import NDArray

from . import Episode, Pipeline, pressure_table_kpa

Given = Episode | str | os.PathLike[str]
Row = dict[str, NDArray[Any]]

META = "meta/slipsense.json"
VERSION = 1
#: Arrays of an episode that need not be there, by what they are called here: one number per scan.
TRUTH = {"label": "int64", "slip_true": "float32", "slip_fraction": "float32", "displacement_mm": "float32"}
#: What the pipeline says of a scan; `health` is of each sensor.
SAYS = ("class_index", "slip", "may_begin", "invalid", "degraded")


def _opened(episode):
    return episode if isinstance(episode, Episode) else Episode.read(episode)


def _scans(fps, rate_hz):
    if fps < 1 or rate_hz % fps:
        raise ValueError(f"fps {fps}: must divide the {rate_hz:.0f} scans of a second")
    return int(rate_hz) // fps


def _ends(episode, scans):
    """Index of the sample after the last of each row: what comes after the last scan belongs to the last row."""
    last = numpy.minimum(numpy.arange(scans, episode.frames + scans, scans), episode.frames) - 1
    ends = episode.xl_end[last].astype(numpy.int64)
    ends[-1] = episode.xl.shape[1]
    return ends


def chunk(episode: Episode, fps: int = 30) -> int:
    """Samples of the accelerometer in the longest row."""
    ends = _ends(episode, _scans(fps, json.loads(episode.meta)["frame_rate_hz"]))
    return int(numpy.diff(ends, axis=0, prepend=0).max())


def features(episode: Episode, samples: int, fps: int = 30) -> dict[str, dict[str, Any]]:
    """The dataset's features: of this episode's arrays, with `samples` samples a row."""
    scans, sensors = _scans(fps, json.loads(episode.meta)["frame_rate_hz"]), episode.sensors
    shapes = {
        "observation.tactile": ("float32", (scans, *episode.piezo.shape[1:]), ["scan", "sensor", "row", "col"], "kPa"),
        "observation.acceleration": ("float32", (sensors, samples, 3), ["sensor", "sample", "axis"], "g"),
        "tactile.scans": ("int64", (1,), None, "scans"),
        "tactile.samples": ("int64", (sensors,), ["sensor"], "samples"),
        "tactile.xl_end": ("int64", (scans, sensors), ["scan", "sensor"], "samples"),
        "tactile.health": ("int64", (scans, sensors), ["scan", "sensor"], "bits"),
    }
    shapes |= {f"tactile.{name}": ("int64", (scans,), ["scan"], "") for name in SAYS}
    there = {name: dtype for name, dtype in TRUTH.items() if getattr(episode, name) is not None}
    shapes |= {f"tactile.{name}": (dtype, (scans,), ["scan"], "") for name, dtype in there.items()}
    return {name: {"dtype": dtype, "shape": shape, "names": names, "unit": unit}
            for name, (dtype, shape, names, unit) in shapes.items()}


def rows(episode: Episode, samples: int, fps: int = 30, model: bytes | None = None) -> Iterator[Row]:
    """The rows of an episode, {feature: array}; the last is filled up with zeros."""
    meta, wanted, says = json.loads(episode.meta), features(episode, samples, fps), Pipeline(episode.sensors, model)
    scans = _scans(fps, meta["frame_rate_hz"])
    pressure, xl, xl_end = pressure_table_kpa()[episode.piezo], episode.xl, episode.xl_end
    piezo, g = episode.piezo, (xl * meta["xl_lsb_g"]).astype(numpy.float32)
    truth = {name: getattr(episode, name) for name in TRUTH}
    sampled = numpy.zeros(episode.sensors, numpy.int64)
    before = sampled
    for row, ends in enumerate(_ends(episode, scans)):
        made = {name: numpy.zeros(feature["shape"], feature["dtype"]) for name, feature in wanted.items()}
        frames = range(row * scans, min((row + 1) * scans, episode.frames))
        made["tactile.scans"][0] = len(frames)
        made["observation.tactile"][:len(frames)] = pressure[frames.start:frames.stop]
        made["tactile.xl_end"][:len(frames)] = xl_end[frames.start:frames.stop]
        made["tactile.samples"][:] = ends - sampled
        for sensor, (start, end) in enumerate(zip(sampled, ends)):
            made["observation.acceleration"][sensor, :end - start] = g[sensor, start:end]
        for scan, frame in enumerate(frames):
            batch = [(piezo[frame, s], xl[s, before[s]:xl_end[frame, s]]) for s in range(episode.sensors)]
            output, before = says.step(batch), xl_end[frame]
            made["tactile.health"][scan] = [contact.health for contact in output.contact]
            for name in SAYS:
                made[f"tactile.{name}"][scan] = getattr(output, name)
        for name, values in truth.items():
            if values is not None:
                made[f"tactile.{name}"][:len(frames)] = values[frames.start:frames.stop]
        sampled = ends
        yield made


def episode(rows: Iterable[Row], meta: str, name: str = "episode") -> Episode:
    """The episode that became these rows; `meta`: its metadata, JSON text. Raises ValueError that names what is wrong."""
    rows = list(rows)
    table, lsb_g = pressure_table_kpa(), json.loads(meta)["xl_lsb_g"]

    def joined(feature):
        return numpy.concatenate([row[feature][:int(row["tactile.scans"][0])] for row in rows])

    kpa = joined("observation.tactile")
    counts = numpy.searchsorted(table, kpa).clip(max=len(table) - 1)
    if (wrong := numpy.argwhere(table[counts] != kpa)).size:
        at = wrong[0].tolist()
        raise ValueError(f"{name}: `observation.tactile`{at} is {kpa[tuple(at)]}: must be the pressure of a count")
    samples = [[row["observation.acceleration"][sensor, :count] for sensor, count in enumerate(row["tactile.samples"])]
               for row in rows]
    g = numpy.stack([numpy.concatenate(parts) for parts in zip(*samples)])
    arrays = {
        "piezo": counts.astype(numpy.uint16),
        "xl": numpy.rint(g / lsb_g).astype(numpy.int16),
        "xl_end": joined("tactile.xl_end").astype(numpy.uint32),
        "meta": numpy.frombuffer(meta.encode(), numpy.uint8),
    }
    for array, dtype in {**TRUTH, "label": "uint8"}.items():
        if f"tactile.{array}" in rows[0]:
            arrays[array] = joined(f"tactile.{array}").astype(dtype)
    file = io.BytesIO()
    numpy.savez(file, **arrays)
    return Episode.from_bytes(file.getvalue(), name)


def write(episodes: Iterable[Given], root: str | os.PathLike[str], repo_id: str = "local/slipsense", fps: int = 30,
          task: str | Iterable[str] = "grasp", model: bytes | None = None) -> None:
    """Write episodes, or files of them, as a new LeRobot dataset in the folder `root`.

    They need equal sensors and arrays. `task`: the same for all, or one each. An error leaves no folder.
    """
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    episodes, root = list(episodes), pathlib.Path(root)
    tasks = [task] * len(episodes) if isinstance(task, str) else list(task)
    if root.exists():
        raise ValueError(f"{root}: is there already")
    if not episodes or len(tasks) != len(episodes):
        raise ValueError(f"{len(episodes)} episodes and {len(tasks)} tasks: must be as many, one at least")
    samples = max(chunk(_opened(given), fps) for given in episodes)
    wanted = features(_opened(episodes[0]), samples, fps)
    for given in episodes:
        found = features(_opened(given), samples, fps)
        for name in wanted | found:
            shapes = [tuple(of.get(name, {}).get("shape", ())) for of in (found, wanted)]
            if shapes[0] != shapes[1]:
                raise ValueError(f"{given}: `{name}` has shape {shapes[0]}: must have {shapes[1]} as in {episodes[0]}")
    root.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=root.parent, prefix=".slipsense-", suffix=".partial") as folder:
        made, about = pathlib.Path(folder) / "dataset", []
        dataset = LeRobotDataset.create(repo_id, fps, wanted, root=made, robot_type="slipsense", use_videos=False)
        try:
            for number, (given, words) in enumerate(zip(episodes, tasks)):
                opened = _opened(given)
                for row in rows(opened, samples, fps, model):
                    dataset.add_frame({**row, "task": words})
                dataset.save_episode()
                # A recording says by which calibration each pad was read.
                said = json.loads(opened.meta).get("calibration", {})
                calibrated = ["none" not in said.get(str(sensor), "none") for sensor in range(opened.sensors)]
                name = f"episode {number}" if isinstance(given, Episode) else os.fspath(given)
                about.append({"name": name, "calibrated": calibrated, "meta": opened.meta})
        finally:
            # Else lerobot does it later, when the folder is gone.
            dataset.finalize()
        (made / META).write_text(json.dumps({"version": VERSION, "fps": fps, "episodes": about}))
        os.rename(made, root)


def read(root: str | os.PathLike[str], repo_id: str = "local/slipsense") -> Iterator[Episode]:
    """The episodes of a dataset that `write` made, in order."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    file = pathlib.Path(root) / META
    try:
        about = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{file}: must be what slipsense.lerobot.write made: {error}") from None
    if about.get("version") != VERSION:
        raise ValueError(f"{file}: `version` is {about.get('version')}: must be {VERSION}")
    dataset = LeRobotDataset(repo_id, root=root)
    stored = dataset.hf_dataset.with_format("numpy")
    shapes = {name: tuple(feature["shape"]) for name, feature in dataset.features.items()}
    for said, bounds in itertools.zip_longest(about["episodes"], dataset.meta.episodes):
        if said is None or bounds is None:
            raise ValueError(f"{file}: `episodes` must be as many as the dataset's, {dataset.num_episodes}")
        found = stored[bounds["dataset_from_index"]:bounds["dataset_to_index"]]
        found = {name: numpy.asarray(values).reshape(-1, *shapes[name]) for name, values in found.items()}
        made = ({name: values[row] for name, values in found.items()} for row in range(len(found["index"])))
        yield episode(made, said["meta"], f"{root}: {said['name']}")
