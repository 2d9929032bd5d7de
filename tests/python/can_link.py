"""Carries CAN FD frames between a TCP port and a python-can bus, one to one, until it is closed.

A frame on the TCP side: 4 bytes of identifier, 1 of length, the data; low byte first. The other end is
`tests/twin/src/far_end.rs`.
"""

import socket
import struct
import threading
import time

import can


CHANNEL = "slipsense"
CONNECT_S = 30.0


class CanLink:
    def __init__(self, port):
        deadline = time.monotonic() + CONNECT_S
        while True:
            try:
                self.socket = socket.create_connection(("127.0.0.1", port), timeout=5.0)
                break
            except OSError:
                if time.monotonic() > deadline:
                    raise
                time.sleep(0.1)
        self.socket.settimeout(None)
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.bus = can.Bus(interface="virtual", channel=CHANNEL)
        self.open = True
        self.frames = {"to the node": 0, "from the node": 0}
        self.threads = [threading.Thread(target=self._carry, args=[step], daemon=True) for step in (self._from_node, self._to_node)]
        for thread in self.threads:
            thread.start()

    def _exactly(self, length):
        data = b""
        while len(data) < length:
            part = self.socket.recv(length - len(data))
            if not part:
                raise ConnectionError("the node closed the link")
            data += part
        return data

    def _carry(self, step):
        try:
            while self.open:
                step()
        except OSError:
            if self.open:
                raise

    def _from_node(self):
        identifier, length = struct.unpack("<IB", self._exactly(5))
        message = can.Message(
            arbitration_id=identifier, data=self._exactly(length), is_extended_id=True, is_fd=True, bitrate_switch=True
        )
        self.frames["from the node"] += 1
        self.bus.send(message)

    def _to_node(self):
        message = self.bus.recv(timeout=0.1)
        if message is not None:
            self.frames["to the node"] += 1
            self.socket.sendall(struct.pack("<IB", message.arbitration_id, len(message.data)) + bytes(message.data))

    def close(self):
        self.open = False
        self.socket.shutdown(socket.SHUT_RDWR)
        for thread in self.threads:
            thread.join()
        self.socket.close()
        self.bus.shutdown()
