"""Slip sensing for robot fingertips: the firmware's signal path, its messages and its recordings.

    import slipsense

    episode = slipsense.Episode.read("grasp.npz")
    slip = slipsense.run(episode)["slip"]                   # as `slipsense run`, bit for bit

    pipeline = slipsense.Pipeline(sensors=1)
    output = pipeline.step([(counts, samples)])             # uint16 [32, 32], int16 [n, 3]; either may be None

    for time_us, message in slipsense.Log("can.log"):       # a candump log
        ...

    with can.Bus("can0", interface="socketcan", fd=True) as bus:
        for message in slipsense.live(bus):                 # a bus, through python-can
            if isinstance(message, slipsense.Slip) and message.slip and not message.invalid:
                ...
"""

from ._slipsense import Contact, Episode, Log, Output, Pipeline, Raw, Receiver, Slip, SlipReceiver, run

__all__ = ["Contact", "Episode", "Log", "Output", "Pipeline", "Raw", "Receiver", "Slip", "SlipReceiver", "live", "run"]


def live(bus, node=42, timeout=None):
    """Messages of the module at address `node`, as they come from a python-can bus.

    Ends when nothing was received for `timeout` seconds; None: never. Traffic of others is passed over.
    """
    receiver = Receiver(node)
    while (frame := bus.recv(timeout)) is not None:
        ours = frame.is_fd and frame.is_extended_id and not frame.is_error_frame
        message = receiver.accept(frame.arbitration_id, bytes(frame.data)) if ours else None
        if message is not None:
            yield message
