"""What the process of the plant tells those of the sensors: datagrams on a pair of local sockets.

The plant never waits: what a sensor's process does not fetch is dropped. A sensor that hears nothing says the last
value as frozen, not as new.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable

from needleplan.devices._base import Closing, ForceSample, PoseSample

__all__ = ["FeedReader", "FeedSender", "feed_pair"]

_WRENCH, _POSE = struct.Struct("<6d"), struct.Struct("<9d")
_SILENT_S = 0.1


def feed_pair() -> tuple[socket.socket, socket.socket]:
    """Return the end of the plant and that of a sensor."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)


class FeedSender:
    """The end of the plant."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        end.setblocking(False)

    def send(self, sample: ForceSample | PoseSample) -> None:
        """Tell a sample, or drop it where nobody fetches them."""
        if isinstance(sample, ForceSample):
            data = _WRENCH.pack(*sample.force_n, *sample.torque_n_mm)
        else:
            data = _POSE.pack(sample.stamp.sequence, *sample.quaternion, *sample.position_mm, sample.error_mm)
        with contextlib.suppress(OSError):  # full, or the other process has ended
            self._end.send(data)


class FeedReader(Closing):
    """The end of a sensor: calls `hear` with each sample, and `fall_silent` where none has come for 0.1 s.

    A ForceSample is heard as three forces in N and three torques in N mm; a PoseSample as the number of
    its frame, quaternion (w, x, y, z), position in mm and error in mm, these NaN where the coil is not seen.
    """

    def __init__(
        self,
        end: socket.socket,
        hear: Callable[[tuple[float, ...]], None],
        fall_silent: Callable[[], None],
        kind: type[ForceSample] | type[PoseSample],
    ) -> None:
        self._end, self._hear, self._fall_silent = end, hear, fall_silent
        self._format = _WRENCH if kind is ForceSample else _POSE
        self._ending = threading.Event()
        end.settimeout(_SILENT_S)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while not self._ending.is_set():
            try:
                data = self._end.recv(256)
            except TimeoutError:
                self._fall_silent()
                continue
            except OSError:
                self._fall_silent()
                return
            if len(data) == self._format.size:
                self._hear(self._format.unpack(data))

    def close(self) -> None:
        """Hear no more."""
        self._ending.set()
        self._thread.join()
        self._end.close()
