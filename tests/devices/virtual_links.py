"""Links to simulated devices within one process, on a virtual clock."""

from collections import deque

from needleplan.devices import Link, VirtualClock
from needleplan.devices.ati import NetFtBox
from needleplan.devices.ati._simulator import MEASUREMENTS_PER_S
from needleplan.devices.igtl import PlusDevice
from needleplan.devices.ndi import AuroraDevice
from needleplan.errors import LinkClosed

_HERE = ("in this process", 0)
_NANO = 1_000_000_000


class _VirtualLink(Link):
    """A link to a simulated device within this process, on a virtual clock."""

    def __init__(self, clock: VirtualClock) -> None:
        self._clock = clock
        self._closed = False

    def close(self) -> None:
        self._closed = True

    def unplug(self) -> None:
        """Simulate an unplugged cable: further calls of `send` and `receive` raise LinkClosed."""
        self._closed = True

    def _check(self) -> None:
        if self._closed:
            raise LinkClosed("the link to the device is closed")

    def _pass(self, until_ns: int) -> None:
        self._clock.advance((until_ns - self._clock.now_ns()) / _NANO)


class BoxLink(_VirtualLink):
    """Connects a client to `box`; while `receive` advances `clock`, the box measures."""

    def __init__(self, box: NetFtBox, clock: VirtualClock) -> None:
        super().__init__(clock)
        self.box = box
        self._due_ns = clock.now_ns()
        self._waiting: deque[bytes] = deque()

    def send(self, data: bytes) -> None:
        self._check()
        self.box.request(data, _HERE)

    def receive(self, timeout_s: float) -> bytes:
        """Advance the clock, and return the next datagram from the box; b"" after `timeout_s`."""
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        while not self._waiting and self._due_ns <= end_ns:
            self._pass(self._due_ns)
            datagrams = self.box.step(self._due_ns / _NANO)
            # If another client has requested the stream, its datagrams do not arrive at this link.
            self._waiting.extend(datagrams if self.box.client == _HERE else ())
            self._due_ns += round(self.box.settings.divisor / MEASUREMENTS_PER_S * _NANO)
        if self._waiting:
            return self._waiting.popleft()
        self._pass(end_ns)
        return b""


class PlusLink(_VirtualLink):
    """Connects a client to `device`; frames are queued for the client as the clock advances."""

    def __init__(self, device: PlusDevice, clock: VirtualClock) -> None:
        super().__init__(clock)
        self.device = device
        self._began_ns = clock.now_ns()
        self._frames = 0
        self._coming: deque[bytes] = deque()

    def send(self, data: bytes) -> None:
        self._check()
        if reply := self.device.answer(data):
            self._coming.append(reply)

    def receive(self, timeout_s: float) -> bytes:
        """Return all bytes that have arrived; the clock advances until some do, at most by `timeout_s`."""
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        while True:
            self._catch_up()
            if self._coming:
                data = b"".join(self._coming)
                self._coming.clear()
                return data
            if self._clock.now_ns() >= end_ns:
                return b""
            self._pass(min(self._due_ns, end_ns))

    def say(self, data: bytes) -> None:
        """Queue bytes for the client that are not part of a frame or reply."""
        self._coming.append(data)

    @property
    def _due_ns(self) -> int:
        return self._began_ns + round((self._frames + 1) / self.device.rate_hz * _NANO)

    def _catch_up(self) -> None:
        while self._due_ns <= self._clock.now_ns():
            self._frames += 1
            if data := self.device.frame(self._frames / self.device.rate_hz):
                self._coming.append(data)


class AuroraLink(_VirtualLink):
    """Connects a client to `device`; a reply arrives after 1 ms plus `device.faults.delay_s`."""

    def __init__(self, device: AuroraDevice, clock: VirtualClock) -> None:
        super().__init__(clock)
        self.device = device
        self._coming: deque[tuple[int, bytes]] = deque()

    def send(self, data: bytes) -> None:
        self._check()
        self.say(self.device.answer(data))

    def say(self, data: bytes) -> None:
        """Queue bytes that the device sends to the client, also without a request."""
        due_ns = self._clock.now_ns() + round((0.001 + self.device.faults.delay_s) * _NANO)
        if data:
            self._coming.append((due_ns, data))

    def receive(self, timeout_s: float) -> bytes:
        """Advance the clock, and return the next bytes from the device; b"" after `timeout_s`."""
        self._check()
        end_ns = self._clock.now_ns() + round(timeout_s * _NANO)
        if self._coming and self._coming[0][0] <= end_ns:
            due_ns, data = self._coming.popleft()
            self._pass(due_ns)
            return data
        self._pass(end_ns)
        return b""
