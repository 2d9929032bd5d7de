"""Parts and sweeps of a `slipsense` command as tasks on Ray, with the package's own command: nothing else to install.

    python -m slipsense.ray --parts 16 synth --split train --frames 600000 --out /shared/train
    python -m slipsense.ray --parts 8 eval /shared/train --out /shared/eval
    python -m slipsense.ray --sweep hand=umi,tesollo2 --sweep seed=1,2,3 \\
        grasp --hand {hand} --seed {seed} --out /shared/{hand}-{seed}

A task takes one core. A task whose worker dies is given to another worker; a task whose command finds an error ends the
run with that error.
"""

import argparse
import itertools
import os
import sys
from collections.abc import Callable, Iterable, Sequence

import ray
import slipsense

RETRIES = 5


def lines(command: Iterable[str], parts: int | None = None,
          sweep: Iterable[tuple[str, Sequence[str]]] = ()) -> list[list[str]]:
    """The command lines of all tasks: `command` with each value of `sweep`, [(name, [value, ...]), ...], for {name},
    and each of them in `parts` parts."""
    found, sweep = [], list(sweep)
    for values in itertools.product(*(values for _, values in sweep)):
        line = list(command)
        for (name, _), value in zip(sweep, values):
            line = [word.replace("{" + name + "}", value) for word in line]
        found += [[*line, "--shard", f"{part}/{parts}"] for part in range(1, parts + 1)] if parts else [line]
    return found


def _task(line):
    os.environ["RAYON_NUM_THREADS"] = "1"
    slipsense.command(*line)


def run(lines: Sequence[Sequence[str]], retries: int = RETRIES,
        done: Callable[[int, Sequence[str]], None] = lambda count, line: None) -> None:
    """Run command lines on the Ray cluster that is connected. Calls `done` after each; raises ValueError with the
    line of error of the first that fails."""
    task = ray.remote(num_cpus=1, max_retries=retries)(_task)
    running = {task.remote(line): line for line in lines}
    try:
        while running:
            (ended,), _ = ray.wait(list(running), num_returns=1)
            line = running.pop(ended)
            try:
                ray.get(ended)
            except ray.exceptions.RayTaskError as error:
                raise ValueError(f"{' '.join(line)}: {error.cause}") from None
            except ray.exceptions.RayError as error:
                why = type(error).__name__
                raise ValueError(f"{' '.join(line)}: its worker died, after {retries} retries: {why}") from None
            done(len(lines) - len(running), line)
    finally:
        for left in running:
            ray.cancel(left, force=True)


def _sweep(text):
    name, _, values = text.partition("=")
    if not name or not values:
        raise argparse.ArgumentTypeError("must be NAME=VALUE,VALUE,...")
    return name, values.split(",")


def _main():
    parser = argparse.ArgumentParser(prog="python -m slipsense.ray", description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--address", help="cluster to use, as `auto`; a local one if not given")
    parser.add_argument("--workers", type=int, metavar="N", help="workers of the local cluster; one a core if not given")
    parser.add_argument("--parts", type=int, metavar="N", help="cut the command into N parts, by its --shard")
    parser.add_argument("--sweep", type=_sweep, action="append", default=[], metavar="NAME=A,B",
                        help="repeat the command with A, B for {NAME}; may be given several times")
    parser.add_argument("--retries", type=int, default=RETRIES, metavar="N",
                        help=f"how often a task may lose its worker, {RETRIES} if not given")
    parser.add_argument("command", nargs=argparse.REMAINDER, help="the command and its arguments, without `slipsense`")
    options = parser.parse_args()
    if not options.command:
        parser.error("no command given")
    if options.parts is not None and options.parts < 1:
        parser.error(f"--parts {options.parts}: must be at least 1")
    tasks = lines(options.command, options.parts, options.sweep)
    # What is wrong with a second task would be printed behind the first one's error.
    os.environ["RAY_IGNORE_UNHANDLED_ERRORS"] = "1"
    local = {} if options.address else {"num_cpus": options.workers, "include_dashboard": False}
    ray.init(address=options.address, log_to_driver=False, logging_level="error", **local)

    def done(count, line):
        print(f"{count}/{len(tasks)} slipsense {' '.join(line)}", flush=True)

    try:
        run(tasks, options.retries, done)
    except ValueError as error:
        # What Ray has to say when it ends comes before the error, the last line.
        ray.shutdown()
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(_main())
