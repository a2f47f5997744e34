"""Links carry bytes. A protocol turns them into meaning and back, without any input or output of its own.

A link is opened, used with deadlines, and closed by leaving its `with` block. Datagram links (UDP) deliver whole
datagrams; stream links (TCP, serial) deliver bytes as they come. `memory_pair` is two ends of a link in one process.
"""

from __future__ import annotations

import queue
from abc import abstractmethod

from needleplan.devices.closing import Closing
from needleplan.errors import LinkClosed

__all__ = ["Link", "MemoryLink", "memory_pair"]


class Link(Closing):
    """A way to another device; abstract. May be used by one reader and one writer at the same time."""

    @abstractmethod
    def send(self, data: bytes) -> None:
        """Send all of `data`. Raises LinkClosed where nobody can receive it any more."""

    @abstractmethod
    def receive(self, timeout_s: float) -> bytes:
        """Return a datagram, or the bytes that are there; empty after `timeout_s`. Raises LinkClosed."""

    @abstractmethod
    def close(self) -> None:
        """Give the link up; closing twice is harmless."""


class MemoryLink(Link):
    """One end of a link in this process: what is sent arrives whole, in order, at the other end."""

    def __init__(self, incoming: queue.SimpleQueue[bytes | None], outgoing: queue.SimpleQueue[bytes | None]) -> None:
        self._incoming, self._outgoing = incoming, outgoing
        self._closed = False

    def send(self, data: bytes) -> None:
        """Put `data` where the other end finds it."""
        if self._closed:
            raise LinkClosed("this end of the link is closed")
        self._outgoing.put(bytes(data))

    def receive(self, timeout_s: float) -> bytes:
        """Return the next message of the other end, or nothing."""
        if self._closed:
            raise LinkClosed("this end of the link is closed")
        try:
            data = self._incoming.get(timeout=timeout_s) if timeout_s > 0 else self._incoming.get_nowait()
        except queue.Empty:
            return b""
        if data is None:
            self._closed = True
            raise LinkClosed("the other end of the link is closed")
        return data

    def close(self) -> None:
        """Close this end; the other end finds out when it has read what was sent before."""
        if not self._closed:
            self._closed = True
            self._outgoing.put(None)


def memory_pair() -> tuple[MemoryLink, MemoryLink]:
    """Return the two ends of a link in this process."""
    there: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    back: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    return MemoryLink(there, back), MemoryLink(back, there)
