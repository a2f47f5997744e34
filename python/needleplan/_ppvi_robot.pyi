"""The supervisor of a robot in `_ppvi`, a stub of its own; at run time there is no module of this name."""

from typing import Literal, TypeAlias, final

from needleplan._ppvi_guard import _GuardState

__all__ = ["RobotLine", "RobotSupervisor"]

# Ages of stage, loop, force, pose and deadman switch (s), infinite if not watched; shallowest and deepest depth;
# velocities inward and outward; roll
_SupervisedLimits: TypeAlias = tuple[
    tuple[float, float, float, float, float], tuple[float, float], tuple[float, float], float
]
# Times (ns) of the last and of the last usable sample, and whether the device sees nothing
_SupervisedTimes: TypeAlias = tuple[int | None, int | None, bool]

# Session, sequence, times sent and echoed, time held, number, version
_Head: TypeAlias = tuple[int, int, int, int, int, int, int]
# Depth and its velocity, roll and its velocity; faults, state, flags, overruns, missed datagrams
_Body: TypeAlias = tuple[float, float, float, float, int, int, int, int, int]
RobotMessage: TypeAlias = (
    tuple[Literal[0], int, int, _Head, _Body]
    | tuple[Literal[1], int, int]
    | tuple[Literal[2], int, int]
    | tuple[Literal[3]]
)

@final
class RobotLine:
    """A serial line to a robot, which threads serve at a UDP port of this machine. It takes over the descriptor."""

    def __new__(cls, descriptor: int, baud: int) -> RobotLine: ...
    def close(self) -> None: ...
    @property
    def port(self) -> int: ...
    @property
    def failure(self) -> str | None:
        """Why the line carries nothing any more."""

    @property
    def counts(self) -> tuple[int, int, int]:
        """Received bytes, received datagrams, and datagrams for which the line had no room."""

@final
class RobotSupervisor:
    """The supervisor of a robot. Times `now_ns` are those of `time.monotonic_ns`, or of a virtual clock.

    After `serve`, two threads receive from the socket and send what is due; `send` sends, and `receive` returns what
    has arrived. Without `serve`, `send` and `due` return the datagrams to send, and `take` takes what has arrived.
    Messages: (0, time, lost, head, body) is a status, (1, number, result) an answer, (2, version, kind) a datagram of
    another version, (3,) one that was discarded.
    """

    def __new__(cls, now_ns: int) -> RobotSupervisor: ...
    def serve(self, descriptor: int, host: str, port: int, now_ns: int) -> None: ...
    def close(self) -> None: ...
    def begin(
        self, session: int, numbers: tuple[float, float, float, float, float], silence_us: int, valid_us: int,
        key: bytes | None, now_ns: int,
    ) -> None: ...  # fmt: skip
    def next_number(self) -> int: ...
    def deadline_ns(self, within_ns: int, now_ns: int) -> int: ...
    def send(
        self, kind: int, number: int, deadline_ns: int, target: tuple[float, float], now_ns: int
    ) -> bytes | None: ...
    def take(self, datagram: bytes, now_ns: int) -> RobotMessage: ...
    def due(self, now_ns: int) -> list[bytes]: ...
    def receive(self, timeout_s: float) -> RobotMessage | None: ...
    def post(
        self, limits: _SupervisedLimits, fields: _GuardState, trips: int | None, force: _SupervisedTimes,
        pose: _SupervisedTimes, deadman_ns: int | None, now_ns: int,
    ) -> None: ...  # fmt: skip
    def seen(self, stage_age_s: float, now_ns: int) -> tuple[int, int, int, int]: ...
    def tick(self, now_ns: int) -> None: ...
    def withhold(self) -> None: ...
    def longest_gap_ns(self) -> int: ...
    @property
    def counts(self) -> tuple[int, int, int, int, int, int, int]:
        """Received, lost, repeated, unread, malformed, foreign and not authentic datagrams of this session."""

    @property
    def unknown_senders(self) -> int: ...
    @property
    def version(self) -> int: ...
    @property
    def last_number(self) -> int: ...
    @property
    def lost_control(self) -> int | None: ...
    @property
    def accepted(self) -> int | None: ...
    @property
    def received_ns(self) -> int: ...
    @property
    def round_trip_ns(self) -> tuple[int | None, int]: ...
