"""A retraction by a person without an insertion loop: after a fault, and after the end or a crash of a run."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

from needleplan.artifacts import CallRepr
from needleplan.control._deadman_link import Deadman
from needleplan.control.safety import GuardedStage, SafetyLimits, Watchdog
from needleplan.devices import Stage, open_stage
from needleplan.errors import DeviceFault
from needleplan.stopping import Rest

__all__ = ["Retraction", "RetractionOutcome", "RetractionReport", "open_stage_patiently"]

# longest wait (s) for the first stage sample, and for a sample in the loop
_FIRST_S, _TURN_S = 1.0, 0.01
# time (s) between two attempts to take control of a stage
_AGAIN_S = 0.5
# time (s) after `motion_s` for which rest is awaited at the end: an emergency stop acts within it
_EMERGENCY_S = 1.0


class RetractionOutcome(StrEnum):
    """How a retraction ended."""

    REACHED = "reached"
    """The needle was measured at rest at the commanded depth."""

    STOPPED = "stopped"
    """A person has stopped the needle."""

    FAULT = "fault"
    """The stage or its motion has failed; the needle was stopped."""


_STOPPED = RetractionOutcome.STOPPED, "a person has stopped the needle"


@dataclass(frozen=True)
class RetractionReport(CallRepr):
    """Outcome of a retraction, its cause, and the depths (mm) at its begin and end; None if they are not known.

    `rest` is RESTS if the needle was measured at rest at the end; after MOVES and UNKNOWN, treat it as moving.
    """

    outcome: RetractionOutcome
    cause: str
    began_mm: float | None
    ended_mm: float | None
    rest: Rest = Rest.UNKNOWN


def open_stage_patiently(address: str, wait_s: float, on_wait: Callable[[str], None]) -> Stage:
    """Open the stage at an address; repeat failed attempts until `wait_s` has passed.

    After a crash of its controller, a robot accepts another one only after some seconds.

    Parameters
    ----------
    address : str
        Address of the stage.
    wait_s : float
        Time (s) after which no further attempt begins.
    on_wait : callable
        Called once, with the reason of the first failure.

    Returns
    -------
    Stage

    Raises
    ------
    AddressError
        The address is wrong.
    ConfigurationError
        The configuration of the stage cannot be used.
    DeviceFault
        The last attempt failed.
    """
    end_s, told = time.monotonic() + wait_s, False
    while True:
        try:
            return open_stage(address)
        except DeviceFault as fault:
            if time.monotonic() > end_s:
                raise
            if not told:
                on_wait(str(fault))
            told = True
        time.sleep(_AGAIN_S)


class Retraction:
    """One retraction of `stage` to a depth (mm) at a speed (mm/s), through a guard of its own.

    No force sensor and no tracker is needed. With a `deadman`, the needle moves only while a person holds the switch.
    Limits laxer than the defaults need a reason in `accepted_limits`; without it, SafetyError is raised. `on_alarm` is
    called once with MOVES if the needle moves in spite of a stop, and once with UNKNOWN if its rest is unknown.
    """

    def __init__(
        self, stage: Stage, depth_mm: float, velocity_mm_s: float, *, limits: SafetyLimits | None = None,
        by: str = "", deadman: Deadman | None = None, accepted_limits: str = "",
        on_alarm: Callable[[Rest], object] | None = None,
    ) -> None:  # fmt: skip
        self._depth_mm, self._velocity_mm_s, self._by, self._deadman = depth_mm, velocity_mm_s, by, deadman
        self._guard = GuardedStage(stage, limits, accepted_limits=accepted_limits, on_alarm=on_alarm)
        self._ending = threading.Event()
        self._last_mm: float | None = None

    def stop(self) -> None:
        """End the retraction; any thread and any signal handler may call this method. A stop is sent at once."""
        self._ending.set()
        with contextlib.suppress(DeviceFault):
            self._guard.send_stop()

    def run(self) -> RetractionReport:
        """Retract the needle, wait for the end, stop it, and return the report.

        Raises MotionRefused if the depth is not outward or a value is beyond a limit.
        """
        guard, began_mm = self._guard, None
        with guard, Watchdog(guard):
            try:
                self._wait_for_sample()
                began_mm = self._last_mm
                outcome, cause = self._move()
            except DeviceFault as fault:
                if not guard.retractions:
                    raise
                outcome, cause = RetractionOutcome.FAULT, str(fault)
                if self._ending.is_set():
                    outcome, cause = _STOPPED
            guard.stop()
            rest = self._await_rest()
        if outcome is RetractionOutcome.REACHED:
            outcome, cause = self._reached(rest)
        return RetractionReport(outcome, cause, began_mm, self._last_mm, rest)

    def _reached(self, rest: Rest) -> tuple[RetractionOutcome, str]:
        """Return outcome and cause of a retraction that was at its depth, by what was measured after its last stop."""
        if rest is Rest.RESTS and self._arrived:
            return RetractionOutcome.REACHED, f"the needle rests at {self._last_mm:.2f} mm"
        return RetractionOutcome.FAULT, "the needle was at the depth, and did not stay there"

    def _await_rest(self) -> Rest:
        """Wait until the needle was measured at rest, for `motion_s` and 1 s in which an emergency stop may act."""
        end_s = time.monotonic() + self._guard.limits.motion_s + _EMERGENCY_S
        while (rest := self._guard.rest) is not Rest.RESTS and time.monotonic() < end_s:
            try:
                sample = self._guard.measure(_TURN_S)
            except DeviceFault:
                time.sleep(_TURN_S)
                continue
            if sample is not None:
                self._last_mm = sample.depth_mm
            with contextlib.suppress(DeviceFault):
                self._guard.tick()
        return rest

    def _wait_for_sample(self) -> None:
        end_s = time.monotonic() + _FIRST_S
        while self._last_mm is None and time.monotonic() < end_s:
            self._turn()

    def _move(self) -> tuple[RetractionOutcome, str]:
        """Retract until the needle is at the depth, `stop` is called, or the guard ends the motion.

        With a deadman switch, release of the switch stops the needle and pressing it continues the retraction. Without
        one, a motion that ends before the depth is a fault. Returns the outcome and its cause.
        """
        guard, deadman = self._guard, self._deadman
        if deadman is None:
            guard.retract(self._depth_mm, self._velocity_mm_s, self._by)
        while not self._ending.is_set():
            is_held = deadman is None or deadman.is_held(0.0)
            if deadman is not None and is_held != guard.state.retracting:
                if not is_held:
                    guard.stop()
                elif not self._arrived:
                    guard.retract(self._depth_mm, self._velocity_mm_s, self._by)
            self._turn()
            if self._arrived and not guard.state.retracting:
                return RetractionOutcome.REACHED, "the needle was at the depth"
            if deadman is None and not guard.state.retracting:
                causes = (
                    ", ".join(sorted(guard.state.first or guard.state.latched))
                    or "its motion has ended before its goal"
                )
                return RetractionOutcome.FAULT, causes
        return _STOPPED

    @property
    def _arrived(self) -> bool:
        return self._last_mm is not None and self._last_mm <= self._depth_mm + self._guard.limits.following_mm

    def _turn(self) -> None:
        sample = self._guard.read(_TURN_S)
        if sample is not None:
            self._last_mm = sample.depth_mm
        self._guard.tick()
