"""Questions to an NDI device and its answers, one at a time."""

from __future__ import annotations

from needleplan.devices.clock import Clock, Deadline
from needleplan.devices.link import Link
from needleplan.devices.ndi.commands import Refused, encode_command
from needleplan.devices.ndi.replies import ReplyReader
from needleplan.errors import DeviceFault

__all__ = ["Conversation"]


class Conversation:
    """Carries commands and replies over `link`. A device needs up to `reply_s` for some replies."""

    def __init__(self, link: Link, clock: Clock, reply_s: float = 12.0) -> None:
        self.link, self.clock, self.reply_s = link, clock, reply_s
        self.reader = ReplyReader()

    def send(self, name: str, arguments: str = "") -> None:
        """Ask without waiting."""
        self.link.send(encode_command(name, arguments))

    def receive(self, timeout_s: float) -> str | bytes | None:
        """Return the next whole reply; None after `timeout_s`, or as soon as damaged bytes were dropped."""
        deadline = Deadline(self.clock, timeout_s)
        damaged = self.reader.damaged
        while True:
            reply = self.reader.next()
            if reply is not None or self.reader.damaged > damaged:
                return reply
            data = self.link.receive(deadline.left_s)
            self.reader.feed(data)
            if not data and deadline.passed:
                return None

    def ask(self, name: str, arguments: str = "", timeout_s: float | None = None) -> str:
        """Return the text that answers a command. Raises Refused for `ERRORxx`, DeviceFault for silence.

        Replies that came before are not answers to this command and are dropped.
        """
        self.hush()
        self.send(name, arguments)
        deadline = Deadline(self.clock, self.reply_s if timeout_s is None else timeout_s)
        while not deadline.passed:
            reply = self.receive(deadline.left_s)
            if isinstance(reply, str):
                self.refuse(f"{name}:{arguments}", reply)
                return reply
        waited_s = self.reply_s if timeout_s is None else timeout_s
        damage = f"; {self.reader.damaged} damaged bytes" if self.reader.damaged else ""
        raise DeviceFault(f"tracker: no answer to {name}:{arguments} within {waited_s:g} s{damage}")

    def hush(self) -> list[str | bytes]:
        """Drop what has come unasked, and return the whole replies among it."""
        while data := self.link.receive(0):
            self.reader.feed(data)
        replies = []
        while (reply := self.reader.next()) is not None:
            replies.append(reply)
        self.reader.clear()
        return replies

    @staticmethod
    def refuse(command: str, reply: str) -> None:
        """Raise Refused where `reply` is an error."""
        if reply.startswith("ERROR"):
            try:
                code = int(reply[5:7], 16)
            except ValueError:
                code = 0
            raise Refused(command, code)
