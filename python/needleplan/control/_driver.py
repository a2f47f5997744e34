"""Execution of the motions of an insertion: sends commands to the guard, waits for their end, and waits out pauses."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Sequence

from needleplan.control._events import CommandKind, Listener, RunCommand, RunEventName
from needleplan.control._needle import NeedleState, present_causes
from needleplan.control._options import Options
from needleplan.control.safety import Cause, GuardedStage, OperatingState, Order, Owner
from needleplan.devices import Clock, StageSample
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.stopping import Rest

__all__ = ["NeedleDriver", "Retracted"]

# largest distance from the goal (mm, rad) at which a stage at rest counts as arrived
_ARRIVED_MM, _ARRIVED_RAD = 0.3, 0.02
# time limit of a motion: factor of its nominal duration, plus a constant (s); a longer motion is a fault
_DURATION_FACTOR, _DURATION_S = 2.0, 2.0
# time (s) that a gate stays open beyond the nominal duration of a motion: for start and stop of the stage
_ENDS_S = 0.3
# largest share of an opening of a gate that a motion takes, so that it need not begin at once
_SHARE_OF_OPENING = 0.8
# s that each awaited tracker frame adds to the time limit of `settle`
_FRAME_S = 0.5
# time (s) after `motion_s` for which rest is awaited at the end of a run: an emergency stop acts within it
_EMERGENCY_S = 1.0


class Retracted(Exception):
    """Raised in the loop after a person has retracted the needle and resumed the run: the present goal is void."""


class NeedleDriver:
    """Moves the needle by commands to the guard, and receives samples until each motion has ended.

    `tell(name, causes, text)` is called with PAUSED and the names of the causes when a pause begins, with RESUMED when
    the pause ends, and with WAITING when the needle waits for its gate.

    While a method waits, it raises DeviceFault if the guard stops the run or no device sends samples, Stopped if the
    operator stops the run, and Retracted after a retraction by a person, when a person has resumed the run.
    """

    def __init__(
        self, needle: NeedleState, guard: GuardedStage, clock: Clock, options: Options, listeners: Sequence[Listener],
        tell: Callable[[RunEventName, str, str], None],
    ) -> None:  # fmt: skip
        self.goal_mm = 0.0
        """Path length at which the present insertion ends (mm)."""

        self.moved = False
        """Whether the stage has accepted any motion command."""

        self._before_failure: StageSample | None = None
        """Last stage sample before the first command that failed after it was sent; None without such a command."""

        self._needle, self._guard, self._clock, self._options = needle, guard, clock, options
        self._listeners, self._tell = listeners, tell
        self._enabled = self._resumed = False
        self._retractions = 0
        self._commanded_at = -1
        """Number of stage samples received before the last command; only later samples show its effect."""

    def enable(self) -> None:
        """Declare the stage homed, wait until the guard reports no cause of a stop, and enable the guard.

        The wait ends after `silence_s`; only the wait for a person to hold the deadman switch has no limit. Raises
        MotionRefused if the guard refuses an order, and DeviceFault if the needle was not measured at rest.
        """
        self._guard.order(Order.HOME, self._options.homed_by or Owner.LOOP)
        end_ns = self._clock.now_ns() + round(self._options.silence_s * 1e9)
        while (present := self._guard.state.present) and (
            self._clock.now_ns() < end_ns or present == {Cause.DEADMAN_RELEASED}
        ):
            self._receive()
        self._guard.order(Order.ENABLE, Owner.LOOP)
        while self._guard.state.waits and self._clock.now_ns() < end_ns:
            self._receive()  # until the needle rests
        if self._guard.state.operating is not OperatingState.ENABLED:
            raise DeviceFault(f"the needle was not measured at rest: {present_causes(self._guard) or 'it still moves'}")
        self._enabled = True

    def wait_until(self, done: Callable[[], bool], limit_s: float, failure: str) -> None:
        """Receive samples and wait out pauses until `done()` is true.

        Raises DeviceFault with the message `failure` after `limit_s`, to which pauses do not count.
        """
        end_ns = self._clock.now_ns() + round(limit_s * 1e9)
        while not done():
            if self._clock.now_ns() > end_ns:
                raise DeviceFault(f"{failure} within {limit_s:.3g} s")
            self._receive()
            if self._paused:
                end_ns += self._wait_out_pause()

    def settle(self, frames: int) -> None:
        """Receive samples until the tracker has sent `frames` more usable frames.

        Raises DeviceFault after `silence_s` plus 0.5 s for each frame, and with a gate two breaths.
        """
        enough = self._needle.frames + frames
        limit_s = self._options.silence_s + frames * _FRAME_S + self._breath_s
        self.wait_until(lambda: self._needle.frames >= enough, limit_s, "tracker: no usable frames")

    def begin_insert(self, path_mm: float) -> None:
        """Wait out a pause, then begin to move until the path has the length `path_mm` (mm).

        With a gate, the motion has parts, each of which begins and ends while the gate is open. Raises MotionRefused or
        the DeviceFault of the stage.
        """
        while (part_mm := self._gated(path_mm)) != path_mm:
            self._begin_insert(part_mm)
            self.finish_insert()
        self._begin_insert(path_mm)

    def _gated(self, path_mm: float) -> float:
        """Wait until the gate is open for a motion, or for the most of it that one opening allows; return its end (mm).

        Without a gate, do not wait, and return `path_mm`.
        """
        gate, speed, here_mm = self._options.gate, self._options.velocity_mm_s, self._needle.path_mm
        if gate is None:
            return path_mm
        needed_s = abs(path_mm - here_mm) / speed + _ENDS_S
        part_s = min(needed_s, _SHARE_OF_OPENING * gate.longest_s)

        def waits_s() -> float:
            wait_s, open_s = gate.window(self._clock.now_ns() * 1e-9)
            return wait_s or (0.0 if open_s >= part_s else gate.breathing.period_s + open_s - gate.longest_s)

        if (wait_s := waits_s()) > 0:
            now_s = self._clock.now_ns() * 1e-9
            closed_s, open_s = gate.window(now_s)
            why = (
                f"until the tissue is within {gate.within_mm:g} mm of the plan; now {gate.off_mm(now_s):.1f} mm off"
                if closed_s
                else f"until the gate opens again: open for {open_s:.1f} s more, the motion takes {part_s:.1f} s"
            )
            self._tell(RunEventName.WAITING, "breathing", f"{wait_s:.1f} s {why}")
            self.wait_until(lambda: waits_s() <= 0, wait_s + _DURATION_S, "gate: did not open")
        left_mm = path_mm - here_mm
        return path_mm if part_s == needed_s else here_mm + math.copysign(speed * (part_s - _ENDS_S), left_mm)

    def _begin_insert(self, path_mm: float) -> None:
        options = self._options
        depth = path_mm + options.entry_depth_mm
        self._command(lambda: self._guard.insert(depth, options.velocity_mm_s))
        self.goal_mm = path_mm
        self._commanded(CommandKind.INSERT, depth, options.velocity_mm_s)

    def finish_insert(self, early_mm: float = 0.0) -> None:
        """Wait until the stage rests at `goal_mm`, or until at most `early_mm` (mm) are left to `goal_mm`.

        After a pause the insertion is commanded again. If the stage rests, `goal_mm` becomes the reached path length.
        Raises DeviceFault after twice the nominal duration plus 2 s, and with a gate two breaths.
        """
        needle, goal = self._needle, self.goal_mm
        limit_s = (
            _DURATION_FACTOR * abs(goal - needle.path_mm) / self._options.velocity_mm_s + _DURATION_S + self._breath_s
        )

        def arrived() -> bool:
            if self._resumed:
                self._begin_insert(self._gated(goal))
            if self._unseen or needle.stage is None:
                return False
            left = goal - needle.path_mm
            return 0 < left <= early_mm or (not needle.stage.moving and abs(left) <= _ARRIVED_MM)

        self.wait_until(arrived, limit_s, f"stage: did not come to rest at {goal:.4g} mm")
        if needle.stage is not None and not needle.stage.moving:
            self.hold()  # the next step starts from the length that was reached

    def hold(self) -> None:
        """Set the goal to the present path length."""
        self.goal_mm = self._needle.path_mm

    def rotate(self, roll_rad: float) -> None:
        """Rotate the base, and with it the tip, to the roll `roll_rad`; at 0 the needle bends to the left.

        If the options contain a torsion model with a lag above 0.002 rad, the base first rotates beyond the goal by the
        lag and then returns to the goal. Raises DeviceFault if the base does not come to rest at a goal in time.
        """
        options, needle = self._options, self._needle
        goals = [roll_rad]
        if options.torsion is not None:
            inside = max(needle.path_mm, 0.0)
            outside = max(options.needle_length_mm - inside, 0.0)
            if options.torsion.lag_rad(outside, inside) > _ARRIVED_RAD / 10:
                turning = options.torsion.compensated_rad(needle.roll_rad, roll_rad, outside, inside)
                goals = turning[1:].tolist()
        for goal in goals:
            self._rotate_base(float(goal) + options.roll_left_rad)

    def halt(self, *, latch: bool) -> Rest:
        """Stop both axes and disable the guard, in any state, and return whether the needle was measured at rest.

        FAULT remains. If `latch`, the guard can be enabled again only after a person has reset it. A retraction by a
        person stays in force: it is awaited for `retraction_s`, then stopped. Rest is awaited for `motion_s` of the
        limits, and for 1 s more in which an emergency stop may act.
        """
        self._enabled = False
        with contextlib.suppress(MotionRefused):  # a blocked guard has sent a stop
            self._guard.order(Order.STOP if latch else Order.DISABLE, Owner.LOOP)
        self._emit(CommandKind.STOP, math.nan, math.nan)
        end_ns = self._clock.now_ns() + round(self._guard.retraction_s * 1e9)
        while self._guard.state.retracting and self._clock.now_ns() < end_ns:
            self._needle.attend()
        if self._guard.state.retracting:
            self._guard.stop()  # the stage does not say where it is; the robot must not be left moving
        end_ns = self._clock.now_ns() + round((self._guard.limits.motion_s + _EMERGENCY_S) * 1e9)
        while (rest := self._guard.rest) is not Rest.RESTS and self._clock.now_ns() < end_ns:
            self._needle.attend()
        return rest

    def has_moved(self) -> bool:
        """Return whether the needle was moved: by a command that was accepted, or by one that failed all the same.

        After a command that failed, the needle is stopped, and its measured positions tell.
        """
        before = self._before_failure
        if self.moved or before is None:
            return self.moved
        self.halt(latch=True)
        after, limits = self._needle.measured, self._guard.limits
        stays = (
            after is not None
            and abs(after.depth_mm - before.depth_mm) <= limits.rest_mm
            and abs(after.roll_rad - before.roll_rad) <= limits.rest_rad
        )
        return not stays

    @property
    def _breath_s(self) -> float:
        """Longest time (s) that a gate adds to a wait: the duration of two breaths; 0 without a gate."""
        return 2 * self._options.gate.breathing.period_s if self._options.gate else 0.0

    @property
    def _paused(self) -> bool:
        return self._enabled and self._guard.state.operating is OperatingState.PAUSED

    @property
    def _unseen(self) -> bool:
        """Whether no stage sample has been received since the last command."""
        return self._needle.stage_samples <= self._commanded_at

    def _receive(self) -> None:
        """Receive at most one sample. Raises DeviceFault, with the cause, if the guard has stopped the run."""
        self._needle.receive()
        self._require_running()
        if not self._paused:
            self._require_goal()

    def _require_goal(self) -> None:
        """Raise Retracted if a person has retracted the needle since the last call."""
        if self._enabled and self._guard.retractions != self._retractions:
            self._retractions = self._guard.retractions
            raise Retracted

    def _require_running(self) -> None:
        if self._enabled and self._guard.state.operating in (OperatingState.FAULT, OperatingState.DISABLED):
            raise DeviceFault(self._needle.why_stopped())

    def _wait_out_pause(self) -> int:
        """Wait for the end of a pause, and return its duration (ns).

        A pause that a person ordered ends when a person resumes the run. The loop itself ends any other pause when no
        cause is present and the stage rests. Raises DeviceFault if such a pause lasts `resume_s`, and Retracted at the
        end of a pause in which a person has retracted the needle.
        """
        guard, began_ns = self._guard, self._clock.now_ns()
        counted_ns = began_ns
        causes = "ordered by a person" if guard.state.person_paused else present_causes(guard)
        self._tell(RunEventName.PAUSED, causes, "a stop was sent")
        while self._paused:
            state = guard.state
            if not state.person_paused:
                if not state.present and state.waits is None:
                    # Waits for rest. Refused if a person has just paused the run, or a cause has just appeared.
                    with contextlib.suppress(MotionRefused):
                        if guard.order(Order.RESUME, Owner.LOOP).operating is OperatingState.ENABLED:
                            continue
                if Cause.DEADMAN_RELEASED in state.present:
                    counted_ns = self._clock.now_ns()  # a person may release the switch for as long as the run lasts
                elif (self._clock.now_ns() - counted_ns) * 1e-9 >= self._options.resume_s:
                    raise DeviceFault(f"paused for {self._options.resume_s:g} s: {present_causes(guard) or causes}")
            self._receive()
        self._require_running()
        self._resumed = True
        self._tell(RunEventName.RESUMED, "", "the insertion continues")
        self._require_goal()
        return self._clock.now_ns() - began_ns

    def _rotate_base(self, goal_rad: float) -> None:
        options, needle = self._options, self._needle
        assert needle.stage is not None
        limit_s = _DURATION_FACTOR * abs(goal_rad - needle.stage.roll_rad) / options.velocity_rad_s + _DURATION_S

        def begin() -> None:
            self._command(lambda: self._guard.rotate(goal_rad, options.velocity_rad_s))
            self._commanded(CommandKind.ROTATE, goal_rad, options.velocity_rad_s)

        def arrived() -> bool:
            if self._resumed:
                begin()
            stage = needle.stage
            if self._unseen or stage is None:
                return False
            return not stage.moving and abs(stage.roll_rad - goal_rad) <= _ARRIVED_RAD

        begin()
        self.wait_until(arrived, limit_s, f"stage: did not come to rest at a roll of {goal_rad:.4g} rad")

    def _command(self, send: Callable[[], None]) -> None:
        """Wait out a pause, then send a command; again if a pause has begun meanwhile."""
        while True:
            if self._paused:
                self._wait_out_pause()
            before = self._needle.measured
            try:
                send()
            except MotionRefused as refusal:
                if self._paused:
                    continue
                if Cause.STOP_ORDERED not in refusal.causes:
                    raise
                self._before_failure = self._before_failure or before
                self._receive()  # a stop has overtaken the command, and its order follows
            except DeviceFault:
                self._before_failure = self._before_failure or before
                raise
            else:
                return

    def _commanded(self, kind: CommandKind, goal: float, speed: float) -> None:
        self.moved, self._resumed = True, False
        self._commanded_at = self._needle.stage_samples
        self._emit(kind, goal, speed)

    def _emit(self, kind: CommandKind, goal: float, speed: float) -> None:
        command = RunCommand(self._clock.now_ns(), kind, goal, speed)
        for listener in self._listeners:
            listener.command(command)
