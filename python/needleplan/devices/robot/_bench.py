"""A robot on the bench of its maker, and the controllers that test it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from needleplan.devices._base import Closing
from needleplan.devices._clock import Clock, SystemClock
from needleplan.devices._links import Link
from needleplan.devices.robot._codes import RobotKind
from needleplan.devices.robot._probe import ProbedMotion, RobotProbe
from needleplan.devices.robot._way import RobotWay
from needleplan.errors import AddressError, DeviceFault, Mistake

__all__ = ["RobotBench"]

_MOST_MM, _FASTEST_MM_S = 10.0, 10.0  # longest motion of a test (mm), and its largest speed (mm/s)
_SPAN_S = 0.4  # shortest duration (s) of a whole motion


class RobotBench(Closing):
    """A robot under test, at rest and without a controller; `connect` opens a link to it.

    The robot may move by `may_move_mm` (mm, 1 to 10, negative: outwards) from its present depth. `motion` says where it
    will move. `close` closes the `way` to the robot. Raises DeviceFault if the robot does not answer, has a controller,
    or moves, and AddressError if `may_move_mm` is outside its range.
    """

    def __init__(
        self, connect: Callable[[], Link], may_move_mm: float, key: bytes | None = None, clock: Clock | None = None,
        way: RobotWay | None = None,
    ) -> None:  # fmt: skip
        if not 1 <= abs(may_move_mm) <= _MOST_MM:
            rule = f"must be from 1 to {_MOST_MM:g} mm, or from -{_MOST_MM:g} to -1 mm to move outwards"
            raise AddressError(Mistake("may_move_mm", f"{may_move_mm:g}", rule))
        self._connect, self._way = connect, way
        self.key: bytes | None = key
        self._clock: Clock = SystemClock() if clock is None else clock
        self._probes: list[RobotProbe] = []
        self._motion: ProbedMotion | None = None
        with self.closing():
            probe = self.probe()
            probe.expect(probe.hello())
            probe.rests("HELLO")
            first = probe.last
        speed_mm_s = min(abs(may_move_mm) / _SPAN_S, _FASTEST_MM_S)
        self._motion = ProbedMotion(
            first.depth_mm, first.depth_mm + may_move_mm, first.roll_rad, speed_mm_s, abs(may_move_mm) / speed_mm_s
        )
        self.was_homed: bool = bool(first.homed)
        self.rests: bool = True
        """Whether the needle was measured at rest after the last case."""

    @property
    def motion(self) -> ProbedMotion:
        """The motion that the test may make."""
        assert self._motion is not None
        return self._motion

    def close(self) -> None:
        """Close the way to the robot."""
        if self._way is not None:
            self._way.close()

    def probe(self) -> RobotProbe:
        """Return a new controller on a link of its own; nothing is sent."""
        self._probes.append(RobotProbe(self._connect, self._clock, self.key, self._motion))
        return self._probes[-1]

    def ready(self) -> RobotProbe:
        """Return a new controller that has enabled the robot."""
        return self.probe().enable()

    @contextlib.contextmanager
    def closing(self) -> Iterator[None]:
        """Context at whose end all controllers stop and release the robot, the last controller first."""
        try:
            yield
        finally:
            while self._probes:
                with contextlib.suppress(DeviceFault):
                    self._probes.pop().close()

    def foreign_stop(self) -> RobotProbe:
        """Send a STOP with session 0 from another sender, without a tag; return the sender."""
        other = self.probe()
        other.session, other.seal = 0, None
        other.expect(other.timeless(RobotKind.STOP))
        return other
