"""Slip sensing for robot fingertips: the firmware's signal path, its messages and its recordings.

    import slipsense

    episode = slipsense.Episode.read("grasp.npz")
    slip = slipsense.run(episode)["slip"]                   # as `slipsense run`, bit for bit

    pipeline = slipsense.Pipeline(sensors=1)
    output = pipeline.step([(counts, samples)])             # uint16 [32, 32], int16 [n, 3]; either may be None

    for time_us, message in slipsense.Log("can.log"):       # a candump log
        ...

    episode.to_xarray().pressure.sum(["row", "col"])         # named axes and units: kPa, g, seconds
    slipsense.command("synth", "--split", "umi_ood", "--out", "out/umi_ood")   # the command `slipsense`

    with can.Bus("can0", interface="socketcan", fd=True) as bus:
        for message in slipsense.live(bus):                 # a bus, through python-can
            if isinstance(message, slipsense.Slip) and message.slip and not message.invalid:
                ...
"""

import signal
import sys
import time

from . import _slipsense
from ._slipsense import (
    Contact, Episode, Log, Output, Pipeline, Raw, Receiver, Slip, SlipReceiver, command, pressure_table_kpa, run,
)

__all__ = ["Contact", "Episode", "Log", "Output", "Pipeline", "Raw", "Receiver", "Slip", "SlipReceiver", "command",
           "live", "pressure_table_kpa", "run"]


def live(bus, node=42, timeout=None):
    """Messages of the module at address `node`, as they come from a python-can bus; it does not end.

    Raises TimeoutError when the module sent no message for `timeout` seconds; None: never. Traffic of others is passed
    over.
    """
    receiver, heard = Receiver(node), time.monotonic()
    while True:
        left = None if timeout is None else max(0.0, heard + timeout - time.monotonic())
        frame = bus.recv(left)
        ours = frame is not None and frame.is_fd and frame.is_extended_id and not frame.is_error_frame
        message = receiver.accept(frame.arbitration_id, bytes(frame.data)) if ours else None
        if message is not None:
            yield message
            heard = time.monotonic()
        elif left is not None and heard + timeout <= time.monotonic():
            raise TimeoutError(f"node {node}: no message for {timeout} s")


def _main():
    """The command. Python would not pass an interrupt on before the command ends."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    return _slipsense.main(["slipsense", *sys.argv[1:]])
