"""The Python package, installed from its wheel, against what `slipsense demo` wrote about the bundled episode.

    check_package.py EPISODE.npz PREDICTIONS.npz CAN.log
"""

import pathlib
import sys
import threading
import time

import can
import numpy
import slipsense

from checks import require

FRAME_RATE_HZ = 240


def refused(call, *words):
    try:
        call()
    except ValueError as error:
        missing = [word for word in words if word not in str(error)]
        require(not missing, f"refused: {error}")
    else:
        sys.exit(f"error: nothing said about {words}")


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
    require(all((raw.piezo == arrays[0][raw.sequence, raw.sensor]).all() for raw in raws), "its counts are the episode's")

    on_a_bus(sys.argv[3], messages)
    receiver()

    counts = numpy.zeros((32, 32), numpy.uint16)
    one = slipsense.Pipeline(1)
    one.step([(counts, None)])
    one.step([(None, numpy.zeros((0, 3), numpy.int16))])
    refused(lambda: one.step([]), "0 sensors", "1")
    refused(lambda: one.step([(counts + 5000, None)]), "sensor 0", "12 bits")
    refused(lambda: one.step([(counts[:31], None)]), "sensor 0", "[32, 32]")
    refused(lambda: one.step([(None, numpy.zeros((4, 2), numpy.int16))]), "sensor 0", "[n, 3]")
    refused(lambda: slipsense.Pipeline(4), "4 sensors")
    refused(lambda: slipsense.Pipeline(1, b"no model"), "model")
    refused(lambda: slipsense.Episode.read("none.npz"), "none.npz")
    refused(lambda: slipsense.Receiver(200), "node 200")
    refused(lambda: slipsense.Receiver().accept(5, bytes(65)), "65")


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
        received = list(slipsense.live(receiver, timeout=5))
        thread.join()
    same = len(received) == len(expected) and all(
        type(a) is type(b) and a.sequence == b.sequence and a.timestamp_us == b.timestamp_us
        for a, b in zip(received, expected))
    require(same, f"live: {len(received)} messages through python-can's virtual bus")


if __name__ == "__main__":
    main()
