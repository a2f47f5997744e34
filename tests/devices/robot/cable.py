"""A serial cable between two pseudo-terminals, in a process of its own: paced as by 460,800 baud, and with faults.

The process prints the paths of both ends. Each line on its standard input is a fault that lasts: `lose P` loses each
byte with the probability P, `noise P` adds a random byte after each with P, `cut P` loses the second half of a piece
with P, `garble 1` changes all bytes as a wrong speed does, `unplug 1` closes the end of the controller.
"""

import contextlib
import os
import random
import select
import subprocess
import sys
import time
import tty
from types import TracebackType
from typing import Self

BYTES_S = 460_800 / 10
_TURN_S = 0.0005  # time (s) between two looks at what may pass


class Cable:
    """The cable; `robot` and `controller` are the paths of its ends."""

    def __init__(self, *, paced: bool = True) -> None:
        words = [sys.executable, "-S", "-E", __file__, str(int(paced))]
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        self.robot, self.controller = self._process.stdout.readline().split()
        self.address: str = f"serial://{self.controller}"

    def fault(self, name: str, share: float) -> None:
        """Begin a fault; a share of 0 ends it."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{name} {share}\n")
        self._process.stdin.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()


def _disturbed(data: bytes, faults: dict[str, float], drawn: random.Random) -> bytes:
    if faults.get("garble"):
        return bytes((byte * 5 + 17) & 0xFF for byte in data)
    if drawn.random() < faults.get("cut", 0.0):
        data = data[: len(data) // 2]
    out = bytearray()
    for byte in data:
        if drawn.random() >= faults.get("lose", 0.0):
            out.append(byte)
        if drawn.random() < faults.get("noise", 0.0):
            out.append(drawn.randrange(256))
    return bytes(out)


def _main(paced: bool) -> None:
    ends = [os.openpty(), os.openpty()]  # of the robot, of the controller
    for master, slave in ends:
        tty.setraw(slave)
        os.set_blocking(master, False)
    print(*(os.ttyname(slave) for _, slave in ends), flush=True)
    faults: dict[str, float] = {}
    drawn = random.Random(1)
    waiting, before_s, credit = [b"", b""], time.monotonic(), [0.0, 0.0]
    while True:
        select.select([master for master, _ in ends] + [0], [], [], _TURN_S if any(waiting) else None)
        if select.select([0], [], [], 0)[0]:
            words = os.read(0, 4096).decode().split()
            faults |= dict(zip(words[::2], map(float, words[1::2]), strict=True))
            if faults.get("unplug") and len(ends) == 2:
                for descriptor in ends.pop():
                    os.close(descriptor)
        now_s = time.monotonic()
        passed_s, before_s = now_s - before_s, now_s
        for at, (master, _) in enumerate(ends):
            with contextlib.suppress(OSError):
                waiting[at] += os.read(master, 4096) if len(waiting[at]) < 4096 else b""
            room = int(credit[at]) if paced else len(waiting[at])
            piece, waiting[at] = waiting[at][:room], waiting[at][room:]
            credit[at] = min(credit[at] - len(piece) + passed_s * BYTES_S, BYTES_S * 0.002 + passed_s * BYTES_S)
            if piece and len(ends) == 2:
                with contextlib.suppress(OSError):
                    os.write(ends[1 - at][0], _disturbed(piece, faults, drawn))


if __name__ == "__main__":
    _main(sys.argv[1] == "1")
