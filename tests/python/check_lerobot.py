"""The package `lerobot` writes our episodes, reads them, gives batches; what comes back is the same file.

    check_lerobot.py EPISODE.npz FOLDER
"""

import importlib.metadata
import os
import pathlib
import sys

os.environ["HF_HUB_OFFLINE"] = "1"

import slipsense
import torch
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from slipsense import lerobot

from checks import refused, require


def main():
    folder = pathlib.Path(sys.argv[2])
    slipsense.command("synth", "--split", "palm", "--seed", "3", "--frames", "3000", "--out", folder / "set")
    slipsense.command("synth", "--split", "tesollo3", "--seed", "3", "--frames", "700", "--out", folder / "three")
    files = [pathlib.Path(sys.argv[1]), *sorted((folder / "set").glob("*.npz"))]
    three = next((folder / "three").glob("*.npz"))
    print(f"  lerobot {importlib.metadata.version('lerobot')}, torch {torch.__version__}")
    for fps in (30, 240):
        root = folder / f"at{fps}"
        lerobot.write(files, root, fps=fps, task=[f"task {number}" for number in range(len(files))])
        count = 0
        for file, again in zip(files, lerobot.read(root), strict=True):
            again.write(folder / "again.npz")
            slipsense.Episode.read(file).write(folder / "once.npz")
            if (folder / "again.npz").read_bytes() != (folder / "once.npz").read_bytes():
                require(False, f"{file}: the same bytes after a round trip at {fps} a second")
            count += again.frames
        require(count > 3000, f"{len(files)} synthetic episodes, {count} scans at {fps} a second and back: every byte")

    root, scans = folder / "at30", 8
    dataset = LeRobotDataset("local/slipsense", root=root, delta_timestamps={"observation.tactile": [-1 / 30, 0]})
    batches = list(torch.utils.data.DataLoader(dataset, batch_size=16))
    require(sum(len(batch["index"]) for batch in batches) == len(dataset), f"{len(dataset)} rows in {len(batches)} batches")
    first = slipsense.Episode.read(files[0])
    pressure = first.to_xarray().pressure.values
    require(batches[1]["observation.tactile"].shape == (16, 2, scans, 2, 32, 32)
            and (batches[1]["observation.tactile"][4, 0].numpy() == pressure[19 * scans:20 * scans]).all()
            and (batches[1]["observation.tactile"][4, 1].numpy() == pressure[20 * scans:21 * scans]).all(),
            "a batch holds windows of kPa, the row before beside each")
    flags = torch.cat([batch["tactile.slip"] for batch in batches])[:first.frames // scans].flatten().numpy()
    require((flags == slipsense.run(first)["slip"][:len(flags)]).all(), "and the flags of `slipsense run`")
    require(batches[-1]["task"][-1] == f"task {len(files) - 1}" and dataset.meta.fps == 30
            and dataset.meta.features["observation.tactile"]["unit"] == "kPa", "and the tasks; info.json has the units")

    refused(lambda: lerobot.write(files, root), "at30", "is there already")
    refused(lambda: lerobot.write([*files, three], folder / "x"), three.name, "observation.tactile", "(8, 3, 32, 32)")
    refused(lambda: lerobot.write(files, folder / "x", model=b"no model"), "model")
    refused(lambda: lerobot.write([], folder / "x"), "0 episodes")
    (root / "meta/slipsense.json").write_text("{}")
    refused(lambda: list(lerobot.read(root)), "slipsense.json", "version")
    (root / "meta/slipsense.json").unlink()
    refused(lambda: list(lerobot.read(root)), "slipsense.json", "must be")
    left = {path.name for path in folder.iterdir()} - {"set", "three", "at30", "at240", "once.npz", "again.npz"}
    require(not left, "an error leaves nothing")


if __name__ == "__main__":
    main()
