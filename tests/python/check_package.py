"""The Python package, installed from its wheel, against what `slipsense demo` wrote about the bundled episode.

    check_package.py EPISODE.npz PREDICTIONS.npz CAN.log
"""

import ast
import inspect
import json
import pathlib
import sys
import tempfile
import threading
import time

import can
import numpy
import slipsense
from slipsense import lerobot

from checks import refused, require

FRAME_RATE_HZ = 240
EPISODE_ARRAYS = ["piezo", "xl", "xl_end", "label", "slip_true", "slip_fraction", "displacement_mm"]


def parts(episode, arrays, frame):
    piezo, xl, xl_end = arrays
    start = xl_end[frame - 1] if frame else [0] * episode.sensors
    return [(piezo[frame, s], xl[s, start[s]:xl_end[frame, s]]) for s in range(episode.sensors)]


def main():
    episode, predictions = slipsense.Episode.read(sys.argv[1]), numpy.load(sys.argv[2])
    file, frames = numpy.load(sys.argv[1]), len(predictions["slip"])
    arrays = episode.piezo, episode.xl, episode.xl_end
    require(all((array == file[name]).all() and array.dtype == file[name].dtype
              for array, name in zip(arrays, ["piezo", "xl", "xl_end"])), f"{episode}: arrays as numpy reads them")
    require((episode.label == file["label"]).all() and '"xl_lsb_g"' in episode.meta, "label and metadata too")

    start = time.perf_counter()
    whole = slipsense.run(episode)
    times = frames / FRAME_RATE_HZ / (time.perf_counter() - start)
    require(sorted(whole) == sorted(predictions.files), f"run gives {', '.join(sorted(whole))}")
    for name in predictions.files:
        require(whole[name].dtype == predictions[name].dtype and (whole[name] == predictions[name]).all(),
              f"{name}: {whole[name].dtype} {list(whole[name].shape)}, every bit as `slipsense run`")
    print(f"  run: {times:.0f} times real time, {episode.sensors} sensors, one core")

    pipeline = slipsense.Pipeline(sensors=episode.sensors)
    start = time.perf_counter()
    outputs = [pipeline.step(parts(episode, arrays, frame)) for frame in range(frames)]
    print(f"  step by step: {frames / FRAME_RATE_HZ / (time.perf_counter() - start):.0f} times real time")
    for name, of in [("class", "class_index"), ("slip", "slip"), ("may_begin", "may_begin"), ("logits", "logits_q10"),
                     ("logmel_std", "logmel_std")]:
        mine = numpy.array([getattr(output, of) for output in outputs])
        require((mine == predictions[name]).all(), f"step: {name} as `slipsense run`")

    # Seven samples missing before frame 8: flagged, and the window starts again, as in the firmware.
    pipeline, dropped, warming = slipsense.Pipeline(sensors=episode.sensors), 32, 4
    flags = []
    for frame in range(12):
        ends = [int(end) + (7 if frame >= 8 else 0) for end in episode.xl_end[frame]]
        output = pipeline.step([(*part, end) for part, end in zip(parts(episode, arrays, frame), ends)])
        flags.append(output.contact[0].health & (dropped | warming))
    require(flags == 3 * [warming] + 5 * [0] + [dropped | warming] + 2 * [warming] + [0],
            f"step: missing samples are flagged, {flags}")

    log = slipsense.Log(sys.argv[3])
    messages = [message for _, message in log]
    slips = [message for message in messages if isinstance(message, slipsense.Slip)]
    raws = [message for message in messages if isinstance(message, slipsense.Raw)]
    require((log.errors, log.missed, len(slips), len(raws)) == (0, 0, frames, frames * episode.sensors),
          f"the log holds {len(slips)} slip messages and {len(raws)} raw ones, none lost")
    logits = ((predictions["logits"] + 2) >> 2).clip(-32768, 32767)
    require(all((slip.logits_q8 == logits[i]).all() and slip.slip == predictions["slip"][i] and slip.contact[0].sum == outputs[i].contact[0].sum for i, slip in enumerate(slips)),
          "its decisions are those of the pipeline")
    require(all(raw.region == (0, 32, 0, 32) and (raw.piezo == arrays[0][raw.sequence, raw.sensor]).all() for raw in raws), "its counts are the episode's")

    stubs()
    views(episode, arrays)
    rows_of_a_learning_set(episode)
    on_a_bus(sys.argv[3], messages)
    receiver()

    counts = numpy.zeros((32, 32), numpy.uint16)
    one = slipsense.Pipeline(1)
    one.step([(counts, None)])
    one.step([(None, numpy.zeros((0, 3), numpy.int16))])
    refused(lambda: one.step([]), "0 sensors", "1")
    refused(lambda: one.step([(counts + 5000, None)]), "sensor 0", "12 bits")
    refused(lambda: one.step([(counts[:31], None)]), "sensor 0", "[32, 32]")
    refused(lambda: one.step([(counts.astype("int64"), None)]), "sensor 0", "uint16")
    refused(lambda: one.step([(None, numpy.zeros((4, 2), numpy.int16))]), "sensor 0", "[n, 3]")
    refused(lambda: slipsense.Pipeline(4), "4 sensors")
    refused(lambda: slipsense.Pipeline(1, b"no model"), "model")
    refused(lambda: slipsense.Episode.read("none.npz"), "none.npz")
    refused(lambda: slipsense.Log("none.log"), "none.log")
    refused(lambda: slipsense.Episode.from_bytes(b"no file", "mine"), "mine", "npz")
    refused(lambda: slipsense.command("run", "none.npz", "--out", "x"), "none.npz")
    refused(lambda: slipsense.command("run", pathlib.Path("x"), "--wrong"), "--wrong")
    refused(lambda: lerobot.features(episode, 1, fps=25), "fps 25", "240")
    refused(lambda: slipsense.Receiver(200), "node 200")
    refused(lambda: slipsense.Receiver().accept(5, bytes(65)), "65")


def stubs():
    """The stubs name what there is, with its arguments."""
    def public(names):
        return {name for name in names if not name.startswith("_")}

    def arguments(node, skip):
        given = node.args
        plain = [argument.arg for argument in given.args[skip:]]
        return plain + ([given.vararg.arg] if given.vararg else [])

    tree = ast.parse(pathlib.Path(slipsense.__file__).with_suffix(".pyi").read_text())
    functions = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    require(sorted([*functions, *classes]) == sorted(slipsense.__all__), "stubs: every name of the package")
    for name, node in functions.items():
        found = list(inspect.signature(getattr(slipsense, name)).parameters)
        require(arguments(node, 0) == found, f"stubs: {name}({', '.join(found)})")
    for name, node in classes.items():
        there, declared = getattr(slipsense, name), {getattr(part, "name", None) or part.target.id: part for part in node.body
                                                     if isinstance(part, (ast.FunctionDef, ast.AnnAssign))}
        methods = {key: part for key, part in declared.items() if isinstance(part, ast.FunctionDef) and key in public(declared)}
        static = {key for key, part in methods.items() if part.decorator_list}
        same = all(arguments(part, key not in static) == [of for of in inspect.signature(getattr(there, key)).parameters
                                                          if of != "self"] for key, part in methods.items())
        require(same and public(declared) == public(vars(there)), f"stubs: {name}, {len(declared)} members")


def views(episode, arrays):
    """xarray, and the episode written again."""
    named, (piezo, xl, _) = episode.to_xarray(), arrays
    lsb_g, table = json.loads(episode.meta)["xl_lsb_g"], slipsense.pressure_table_kpa()
    require((named.pressure.attrs["units"], named.acceleration.attrs["units"]) == ("kPa", "g"), "xarray: units")
    require(dict(named.sizes) == {"frame": 768, "sensor": 2, "row": 32, "col": 32, "sample": 26370, "axis": 3},
            "xarray: named axes")
    require(float(named.time[240]) == 1 and float(named.sample_time[8000]) == 1 and abs(float(named.row_mm[31]) - 28.52) < 1e-5,
            "xarray: coordinates in s and mm")
    require(table.shape == (4096,) and table[0] == 0 and abs(table[4095] - 5000) < 1 and (numpy.diff(table) > 0).all()
            and (named.pressure == table[piezo]).all(), "xarray: 0 to 5000 kPa, each count another")
    require(abs(named.acceleration - xl * lsb_g).max() < 1e-6, "xarray: g")
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / "again.npz"
        episode.write(file)
        again = slipsense.Episode.from_bytes(file.read_bytes())
        require(all((getattr(again, name) == getattr(episode, name)).all() for name in EPISODE_ARRAYS)
                and again.meta == episode.meta, "written and read: the same episode")


def rows_of_a_learning_set(episode):
    """What goes into a LeRobot dataset; `cargo xtask lerobot` lets lerobot itself write and read it."""
    for fps in (16, 30, 240):
        rows = list(lerobot.rows(episode, lerobot.chunk(episode, fps), fps))
        again = lerobot.episode(rows, episode.meta)
        require(all((getattr(again, name) == getattr(episode, name)).all() for name in EPISODE_ARRAYS)
                and again.meta == episode.meta, f"{len(rows)} rows at {fps} a second, and back: every bit")
    flags = numpy.concatenate([row["tactile.slip"] for row in rows])
    require((flags == slipsense.run(episode)["slip"]).all() and rows[0]["observation.tactile"].dtype == numpy.float32,
            "rows: kPa and the flag")
    health = [row["tactile.health"][0, 0] for row in rows[:5]]
    require(health[:3] == [4, 4, 4] and health[3] == 0, "rows: health")
    rows[3]["observation.tactile"][0, 1, 9, 9] += 0.01
    refused(lambda: lerobot.episode(rows, episode.meta, "set"), "set", "observation.tactile", "[3, 1, 9, 9]", "count")


def receiver():
    """The slip receiver against the vectors that Rust and C are held to."""
    vectors = pathlib.Path(__file__).parents[1] / "vectors" / "slip_receiver.txt"
    mine, lines = slipsense.SlipReceiver(), vectors.read_text().splitlines()
    for line in lines:
        now_us, data, *want = line.split(",")
        now_us, check = int(now_us), mine.receive(bytes.fromhex(data), int(now_us))
        found = [check, mine.state(now_us), str(mine.lost), str(int(mine.slip(now_us)))]
        if found != want:
            require(False, f"slip receiver: {line}: {found}")
    require(mine.message.starts == 99 and len(lines) == 38, "slip receiver: every line of the vectors")


def on_a_bus(log, expected):
    """The same messages through python-can's virtual bus, among another node's frames."""
    with can.Bus("slipsense", interface="virtual", receive_own_messages=False) as sender, \
         can.Bus("slipsense", interface="virtual") as receiver:
        def send():
            sender.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"other"))
            for frame in can.CanutilsLogReader(log):
                sender.send(frame)
        thread = threading.Thread(target=send)
        thread.start()
        module = slipsense.live(receiver, timeout=5)
        received = [next(module) for _ in expected]
        thread.join()
        # Traffic of others is no sign of life.
        for _ in range(20):
            sender.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"other"))
        start = time.monotonic()
        try:
            next(slipsense.live(receiver, timeout=0.2))
        except TimeoutError as error:
            require("node 42" in str(error) and time.monotonic() - start < 2, f"live: {error}")
        else:
            require(False, "live: a timeout")
    same = len(received) == len(expected) and all(
        type(a) is type(b) and a.sequence == b.sequence and a.timestamp_us == b.timestamp_us
        for a, b in zip(received, expected))
    require(same, f"live: {len(received)} messages through python-can's virtual bus")


if __name__ == "__main__":
    main()
