"""A robot by another hand: written from the page of version 2 of the protocol, shares no code with the shipped machine.

It has the faults of a robot that does not stop: deaf (it takes no STOP), lying (it answers ACCEPTED, goes on, and says
that nothing moves), late, and mute (no status after a stop). It knows nothing of tags and limits.
"""

import math
import struct
import zlib
from dataclasses import dataclass

HEAD = struct.Struct("<4sBBHIIQQII")
COMMAND = struct.Struct("<QddI")
HELLO, ENABLE, INSERT, ROTATE, STOP, ALIVE, RESET, GOODBYE, STATUS, ANSWER = 1, 2, 3, 4, 5, 6, 7, 8, 0x80, 0x81
ACCEPTED, OLD_SESSION, WRONG_VERSION, LATE, SUPERSEDED, NOT_ENABLED, IN_FAULT = 0, 2, 3, 4, 5, 6, 8
DISABLED, ENABLED, FAULT = 0, 1, 3
WATCHDOG, ESTOP, FOREIGN_STOP = 0x01, 0x02, 0x80
NAMES = struct.Struct("<QBBH")
STATE = struct.Struct("<ddddIBBHI")
LONGEST_STEP_NS = 10_000_000
RUNS_ON_MM = 1e4
"""Goal of a robot that takes a stop for nothing."""


@dataclass
class Character:
    """How the robot treats a stop."""

    deaf: bool = False
    """Whether it takes no STOP, and gives no answer to one; it goes on, deeper than it was told."""

    lies: bool = False
    """Whether it answers ACCEPTED, says that nothing moves, and goes on: deeper than it was told."""

    late_s: float = 0.0
    """Time (s) after which it obeys a STOP."""

    mute: bool = False
    """Whether it sends no status after a stop."""

    no_watchdog: bool = False
    braking_mm_s2: float = 1000.0

    @property
    def is_honest(self) -> bool:
        return not (self.deaf or self.lies or self.late_s or self.mute)


class ForeignRobot:
    """The capture side: `receive` and `tick`, as a simulated network calls them."""

    def __init__(self, character: Character) -> None:
        self.character = character
        self.depth_mm = self.speed_mm_s = self.roll_rad = 0.0
        self.power = True
        """Whether the drives have power; the emergency stop cuts it."""

        self.overruns = 0
        self._goal_mm, self._wanted_mm_s, self._roll_goal_rad, self._turn_rad_s = 0.0, 0.0, 0.0, 0.0
        self._session, self._peer, self._nonce = 0, ("", 0), 7
        self._sequence = self._number = self._accepted = self._answers = self._statuses = 0
        self._state, self._faults = DISABLED, 0
        self._heard_ns = self._silence_ns = self._echo_ns = self._now_ns = self._told_ns = 0
        self._moved_ns = 0
        self._stop_at_ns: int | None = None
        self._witness: tuple[tuple[str, int], int, int, int] | None = None
        self._hushed = False

    @property
    def controller(self) -> tuple[str, int] | None:
        return self._peer if self._session else None

    def receive(self, datagram: bytes, sender: tuple[str, int], now_ns: int) -> bytes:
        self._now_ns = now_ns
        magic, version, kind, size, session, sequence, sent_ns, _, _, number = HEAD.unpack_from(datagram)
        (crc,) = struct.unpack("<I", datagram[-4:])
        if (magic, size) != (b"NPLR", len(datagram)) or zlib.crc32(datagram[:-4]) != crc:
            return b""
        if version != 2:
            return self._answer(0, sent_ns, 0, kind, WRONG_VERSION)
        if kind == STOP and self.character.deaf:
            self._goal_mm = RUNS_ON_MM if self.moves else self._goal_mm
            return b""
        if kind == STOP and session == 0:
            if self._session:
                self._state, self._faults = FAULT, self._faults | FOREIGN_STOP
            self._halt()
            self._witness = sender, now_ns, sent_ns, number
            return self._answer(0, sent_ns, number, kind, ACCEPTED)
        if kind == HELLO and not self._session:
            self._session, self._peer, self._sequence, self._number = session, sender, sequence, number
            self._accepted, self._heard_ns, self._hushed = number, now_ns, False
            return self._answer(session, sent_ns, number, kind, ACCEPTED, self._nonce)
        if session != self._session:
            return self._answer(session, sent_ns, number, kind, OLD_SESSION)
        deadline_ns, target, speed, silence_us = COMMAND.unpack_from(datagram, HEAD.size)
        is_late = kind not in (STOP, GOODBYE) and now_ns > deadline_ns
        if sequence > self._sequence and not is_late:
            self._sequence, self._echo_ns, self._silence_ns = sequence, sent_ns, silence_us * 1000
            if kind != STOP or not self.moves:
                self._heard_ns = now_ns
        if kind == ALIVE:
            return b""
        if number < self._number:
            return self._answer(session, sent_ns, number, kind, SUPERSEDED)
        if number > self._number:
            self._number = number
            self._result = LATE if is_late else self._obey(kind, target, speed)
            if self._result == ACCEPTED:
                self._accepted = number
        return self._answer(session, sent_ns, number, kind, self._result)

    def _obey(self, kind: int, target: float, speed: float) -> int:
        if kind == STOP:
            self._halt()
        elif kind == GOODBYE:
            self._halt()
            self._session = 0
        elif kind == RESET:
            self._state, self._faults = (DISABLED, 0) if self.power else (FAULT, ESTOP)
        elif self._state == FAULT:
            return IN_FAULT
        elif kind == ENABLE:
            self._state = ENABLED
        elif self._state != ENABLED:
            return NOT_ENABLED
        elif kind == INSERT:
            self._goal_mm, self._wanted_mm_s, self._stop_at_ns = target, speed, None
        else:
            self._roll_goal_rad, self._turn_rad_s = target, speed
        return ACCEPTED

    def begin(self, goal_mm: float, speed_mm_s: float) -> None:
        """Move, as a controller of the robot has ordered."""
        self._goal_mm, self._wanted_mm_s = goal_mm, speed_mm_s

    def _halt(self) -> None:
        self._hushed = self.character.mute
        if self.character.lies:
            if self.moves:
                self._goal_mm = RUNS_ON_MM
        elif self._stop_at_ns is None:
            self._stop_at_ns = self._now_ns + round(self.character.late_s * 1e9)

    @property
    def moves(self) -> bool:
        """Whether the needle moves, in truth."""
        return abs(self.speed_mm_s) > 1e-9 or abs(self._goal_mm - self.depth_mm) > 1e-9

    def tick(self, now_ns: int) -> tuple[bytes, tuple[str, int]] | None:
        # All of the time passes, in steps: on a busy machine ticks are far apart, and the needle goes on all the same.
        while self._moved_ns and self._moved_ns < now_ns:
            self._now_ns = min(self._moved_ns + LONGEST_STEP_NS, now_ns)
            self._move((self._now_ns - self._moved_ns) * 1e-9)
            self._moved_ns = self._now_ns
        self._moved_ns = self._now_ns = now_ns
        is_silent = self._silence_ns and now_ns - self._heard_ns > self._silence_ns
        if self._session and self._state == ENABLED and self.moves and is_silent and not self.character.no_watchdog:
            self._state, self._faults = FAULT, self._faults | WATCHDOG
            self._halt()
        if self._session and now_ns - self._heard_ns > 5e9:
            self._session = 0
            self._halt()
        if now_ns - self._told_ns < 4e6 or self._hushed:
            return None
        self._told_ns = now_ns
        if self._witness is not None and now_ns - self._witness[1] < 5e8:
            peer, received_ns, sent_ns, number = self._witness
            return self._status(0, sent_ns, (now_ns - received_ns) // 1000, number), peer
        if not self._session:
            return None
        return self._status(self._session, self._echo_ns, (now_ns - self._heard_ns) // 1000, self._accepted), self._peer

    def _move(self, passed_s: float) -> None:
        if self._stop_at_ns is not None and self._now_ns >= self._stop_at_ns:
            way_mm = self.speed_mm_s**2 / (2 * self.character.braking_mm_s2)
            self._goal_mm = self.depth_mm + math.copysign(way_mm, self.speed_mm_s)
            self._roll_goal_rad = self.roll_rad
            self._stop_at_ns = None
        if not self.power:
            self.speed_mm_s, self._goal_mm, self._roll_goal_rad = 0.0, self.depth_mm, self.roll_rad
        left_mm = self._goal_mm - self.depth_mm
        # As fast as the command says, but no faster than it can brake before its goal.
        fastest_mm_s = math.sqrt(2 * self.character.braking_mm_s2 * abs(left_mm))
        self.speed_mm_s = math.copysign(min(self._wanted_mm_s, fastest_mm_s), left_mm)
        step_mm = self.speed_mm_s * passed_s
        if abs(step_mm) >= abs(left_mm) or abs(left_mm) < 1e-4:
            step_mm, self.speed_mm_s = left_mm, 0.0
        self.depth_mm += step_mm
        left_rad = self._roll_goal_rad - self.roll_rad
        self.roll_rad += math.copysign(min(abs(left_rad), self._turn_rad_s * passed_s), left_rad)

    def _status(self, session: int, echo_ns: int, held_us: int, number: int) -> bytes:
        self._statuses += 1
        is_moving = self.moves or self._roll_goal_rad != self.roll_rad
        says_so = not (self.character.lies and self._goal_mm == RUNS_ON_MM)
        body = STATE.pack(
            self.depth_mm, self.speed_mm_s if says_so else 0.0, self.roll_rad, 0.0, self._faults, self._state,
            is_moving and says_so, 0, 0,
        )  # fmt: skip
        return self._sealed(STATUS, session, self._statuses, echo_ns, held_us, number, body)

    def _answer(self, session: int, echo_ns: int, number: int, asked: int, result: int, nonce: int = 0) -> bytes:
        self._answers += 1
        body = NAMES.pack(nonce, asked, self._state, result)
        return self._sealed(ANSWER, session, self._answers, echo_ns, 0, number, body)

    def _sealed(
        self, kind: int, session: int, count: int, echo_ns: int, held_us: int, number: int, body: bytes
    ) -> bytes:
        size = HEAD.size + len(body) + 4
        begin = HEAD.pack(b"NPLR", 2, kind, size, session, count, self._now_ns, echo_ns, held_us, number) + body
        return begin + struct.pack("<I", zlib.crc32(begin))
