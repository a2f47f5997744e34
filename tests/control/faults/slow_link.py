"""A link whose datagrams come later than they were sent, by a delay that is a function of time."""

from collections import deque
from collections.abc import Callable

from needleplan.devices import VirtualClock
from needleplan.devices._links import Link


class SlowLink(Link):
    """Delays what comes from `inner` by `delay_s(time_s)`, counted from the making of the link; nothing overtakes."""

    def __init__(self, inner: Link, clock: VirtualClock, delay_s: Callable[[float], float]) -> None:
        self._inner, self._clock, self._delay_s = inner, clock, delay_s
        self._begun_ns = clock.now_ns()
        self._coming: deque[tuple[int, bytes]] = deque()

    def send(self, data: bytes) -> None:
        self._inner.send(data)

    def receive(self, timeout_s: float) -> bytes:
        end_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        while True:
            until_ns = min([end_ns, *(due_ns for due_ns, _ in list(self._coming)[:1])])
            data = self._inner.receive(max(until_ns - self._clock.now_ns(), 0) / 1e9)
            now_ns = self._clock.now_ns()
            if data:
                due_ns = now_ns + round(self._delay_s((now_ns - self._begun_ns) / 1e9) * 1e9)
                self._coming.append((max([due_ns, *(each for each, _ in list(self._coming)[-1:])]), data))
            if self._coming and self._coming[0][0] <= now_ns:
                return self._coming.popleft()[1]
            if not data and now_ns >= end_ns:
                return b""

    def close(self) -> None:
        self._inner.close()
