"""The wire to a robot: its datagrams pass through the supervisor of Rust, which also sends without this program."""

from __future__ import annotations

from typing import TYPE_CHECKING

from needleplan import _ppvi
from needleplan.devices._base import Closing
from needleplan.devices._clock import Clock, SystemClock
from needleplan.devices._links import Link, UdpLink
from needleplan.devices.robot._way import RobotWay
from needleplan.devices.robot.messages import MotionLimits, RobotKind
from needleplan.devices.supervision import GuardNumbers, StageSupervisor, SupervisedLimits, SupervisedTimes
from needleplan.errors import LinkClosed

if TYPE_CHECKING:
    from needleplan._ppvi_robot import RobotMessage

__all__ = ["RobotWire"]


class RobotWire(Closing, StageSupervisor):
    """Sends to a robot and receives from it over `link`.

    On a UDP link with the clock of this machine, two threads of Rust own the socket. They never wait for the Python
    interpreter: a STOP and the heartbeats leave while Python computes or hangs. On any other link, such as a simulated
    one with a virtual clock, the same decisions are made whenever this program sends or receives. The link to a robot
    on a serial line is a UDP link to the threads of Rust that own the line, its `way`.
    """

    def __init__(self, link: Link, clock: Clock, way: RobotWay | None = None) -> None:
        self._link, self._clock, self._way = link, clock, way
        self.supervisor: _ppvi.RobotSupervisor = _ppvi.RobotSupervisor(clock.now_ns())
        self.is_native: bool = type(link) is UdpLink and isinstance(clock, SystemClock)
        """Whether the threads of Rust own the socket."""

        self.local_port: int = link.local_port if isinstance(link, UdpLink) else 0
        """The port of this machine that receives the datagrams of the robot; 0 if the link is not UDP."""

        if self.is_native:
            assert isinstance(link, UdpLink)
            self.supervisor.serve(link.hand_over(), *link.peer, clock.now_ns())

    def begin(self, session: int, silence_s: float, limits: MotionLimits, key: bytes | None) -> None:
        """Begin a session; nothing is sent."""
        numbers = (limits.least_mm, limits.most_mm, limits.speed_mm_s, limits.roll_rad, limits.rotation_rad_s)
        self.supervisor.begin(session, numbers, round(silence_s * 1e6), limits.valid_us, key, self._clock.now_ns())

    def send(self, kind: RobotKind, number: int, deadline_ns: int = 0, target: float = 0.0, speed: float = 0.0) -> bool:
        """Send a datagram; return whether the supervisor has let it pass. Raises LinkClosed."""
        data = self.supervisor.send(kind, number, deadline_ns, (target, speed), self._clock.now_ns())
        if data:
            self._link.send(data)
        return data is not None

    def receive(self, timeout_s: float) -> RobotMessage | None:
        """Return the next datagram of the robot, decoded; None after `timeout_s`. Raises LinkClosed."""
        if self._way is not None and self._way.failure:
            raise LinkClosed(f"robot: {self._way.failure}")
        if self.is_native:
            try:
                return self.supervisor.receive(timeout_s)
            except OSError as error:
                raise LinkClosed(f"udp: {error}") from error
        data = self._link.receive(timeout_s)
        message = self.supervisor.take(data, self._clock.now_ns()) if data else None
        self._act()
        return message

    def _act(self) -> None:
        """Send what the supervisor has decided to send."""
        if not self.is_native:
            for data in self.supervisor.due(self._clock.now_ns()):
                self._link.send(data)

    def seen(self, stage_age_s: float) -> tuple[int, int, int, int]:
        """Return the number of trips, the causes and time (ns) of the last trip, and the causes by old samples."""
        return self.supervisor.seen(stage_age_s, self._clock.now_ns())

    def post(self, limits: SupervisedLimits, state: GuardNumbers, trips: int | None, times: SupervisedTimes) -> None:
        """Post the state of the guard, and the times of its inputs."""
        self.supervisor.post(limits, state, trips, *times, self._clock.now_ns())

    def tick(self) -> None:
        """Note that the loop of the program runs."""
        self.supervisor.tick(self._clock.now_ns())
        self._act()

    def withhold(self) -> None:
        """Send no heartbeat until the next `tick`."""
        self.supervisor.withhold()

    def close(self) -> None:
        """End the threads, and close the link and the way to the robot."""
        self.supervisor.close()
        self._link.close()
        if self._way is not None:
            self._way.close()
