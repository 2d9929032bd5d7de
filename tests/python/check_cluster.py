"""`python -m slipsense.ray` on a local cluster of two workers, one of which is killed in the middle: the same bytes and
figures as one process of the command `slipsense`.

    check_cluster.py FOLDER WEIGHTS [FRAMES]
"""

import itertools
import json
import os
import pathlib
import signal
import subprocess
import sys
import time
import uuid

from checks import require

PARTS = 6
OURS = f"SLIPSENSE_CLUSTER={uuid.uuid4()}"


def kill_a_busy_worker():
    """Of our cluster; ends with an error where there is none for ten seconds."""
    deadline = time.monotonic() + 10
    for process in itertools.chain.from_iterable(pathlib.Path("/proc").glob("[0-9]*") for _ in iter(int, 1)):
        if time.monotonic() > deadline:
            sys.exit("error: no worker is busy")
        try:
            is_ours = OURS.encode() in (process / "environ").read_bytes()
            is_busy = b"ray::_task" in (process / "cmdline").read_bytes()
        except OSError:
            # It has ended meanwhile, or is another user's.
            continue
        if is_ours and is_busy:
            os.kill(int(process.name), signal.SIGKILL)
            return


def alone(*words):
    start = time.perf_counter()
    subprocess.run([pathlib.Path(sys.executable).with_name("slipsense"), *words], check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def cluster(*words, kill_after=None):
    """Run on two workers; kill one when `kill_after` tasks are done, and again after the next ones while none has died at
    its task: a worker can end its task between our look at it and the signal."""
    start = time.perf_counter()
    name, value = OURS.split("=")
    command = [sys.executable, "-m", "slipsense.ray", "--workers", "2", "--parts", str(PARTS), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, name: value}) as process:
        done, died, output = 0, False, []
        for line in process.stdout:
            output.append(line)
            # Ray itself notes here that a worker died at its task.
            died |= "A worker died or was killed while executing a task" in line
            if f"slipsense {words[0]}" in line:
                done += 1
                if kill_after is not None and kill_after <= done < PARTS and not died:
                    kill_a_busy_worker()
    is_whole = (process.returncode, done) == (0, PARTS)
    if not is_whole or (kill_after is not None and not died):
        print("".join(output))
    require(is_whole, f"{words[0]}: {PARTS} parts on two workers")
    if kill_after is not None:
        require(died, f"{words[0]}: a worker died at its task")
    return time.perf_counter() - start


def same_files(what, one, many):
    names = sorted(path.name for path in one.iterdir())
    others = sorted(path.name for path in many.iterdir())
    require(names == others, f"{what}: the same files: {', '.join(others)}")
    require(all((one / name).read_bytes() == (many / name).read_bytes() for name in names), f"{what}: every byte of them")


def metrics(folder):
    """All figures, but for the time that they took."""
    found = json.loads((folder / "metrics.json").read_text())
    del found["wall_s"], found["threads"]
    for detector in found["detectors"]:
        del detector["compute_us_per_frame"]
    return found


def main():
    folder, weights, frames = pathlib.Path(sys.argv[1]), sys.argv[2], (sys.argv[3:] or ["50000"])[0]
    one, many = folder / "one", folder / "many"
    made = ["synth", "--split", "umi_ood", "--seed", "5", "--frames", frames, "--out"]
    times = [alone(*made, one / "set"), cluster(*made, many / "set", kill_after=2)]
    same_files("synth", one / "set", many / "set")
    mined = ["mine", weights, "--hours", "0.04", "--out"]
    alone(*mined, one / "mined")
    cluster(*mined, many / "mined")
    same_files("mine", one / "mined", many / "mined")
    detectors = ["network", "entropy", "mfcc-qda", "entropy-and-mfcc"]
    judged = [*itertools.chain.from_iterable(("--detector", name) for name in detectors), "--out"]
    times += [alone("eval", one / "set", *judged, one / "eval"),
              cluster("eval", many / "set", *judged, many / "eval", kill_after=1)]
    require(metrics(one / "eval") == metrics(many / "eval"), "eval: every figure")
    left = sorted(path.name for path in (many / "eval").iterdir())
    require(left == ["metrics.json", "report.html"], f"eval: no part is left: {', '.join(left)}")
    frames = metrics(one / "eval")["inputs"][0]["frames"]
    print(f"  {frames} frames: synth {times[0]:.0f} s alone, {times[1]:.0f} s on the cluster; "
          f"eval {times[2]:.0f} s, {times[3]:.0f} s")

    wrong = subprocess.run([sys.executable, "-m", "slipsense.ray", "--workers", "1", "--parts", "2", "eval", folder / "none",
                            "--out", folder / "x"], capture_output=True, text=True, check=False)
    require(wrong.returncode == 2 and wrong.stderr.rstrip().rpartition("\n")[2].startswith("error: eval ")
            and "none: no such folder" in wrong.stderr, f"an error is the last line: {wrong.returncode}, {wrong.stderr.rstrip()}")


if __name__ == "__main__":
    main()
