"""The needle as the loop has it: moved by the stage, seen by the tracker, one sample at a time.

All that happens is driven by samples in the order of their arrival: the same samples make the same decisions, which is
what a replay relies on. Every sample and every command goes through the guard before the stage.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from needleplan.control.listening import Command, CommandKind, Listener
from needleplan.control.options import Options
from needleplan.control.safety import GuardedStage, OperatingState, Order, SafetyState
from needleplan.devices import Clock, Feed, ForceSample, Health, PoseSample, Sample, StageSample
from needleplan.errors import DeviceFault
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipStatus

__all__ = ["Needle", "Stopped"]

_DEPTH_MM, _ROLL_RAD = 0.3, 0.02
"""How near to its goal a stage must have come to rest."""

_PATIENCE = 2.0
_GRACE_S = 2.0
"""A move may take this many times as long as it should, and this much longer."""

_TURN_S = 0.02
_LAST_WORDS = 100
"""Samples that may wait before the fault of a device that the guard knows of already."""

_TICK_NS = 10_000_000
_LOOP = "the loop, for the operator"


class Stopped(Exception):
    """The operator wants the needle to stop."""


class Needle:
    """Reads the devices, keeps the last sample of each, follows the tip, and carries out moves."""

    def __init__(self, guard: GuardedStage, clock: Clock, options: Options, listeners: Sequence[Listener]) -> None:
        self.options = options
        self.stage: StageSample | None = None
        self.force: ForceSample | None = None
        self.pose: PoseSample | None = None
        self.filter: TipFilter | None = None
        self.frames = 0
        """Good frames of the tracker so far."""

        self.goal_mm = 0.0
        """Length of the path at which the present insertion ends."""

        self.stop_cause = ""
        self.moved = False
        """Whether there was any command."""

        self.on_pause: Callable[[str, str], None] = _unheard
        """Told of a pause, with its causes, and of its end, without."""

        self._guard = guard
        self._clock = clock
        self._feed: Feed | None = None
        self._listeners = listeners
        self._heard_ns = self._ticked_ns = clock.now_ns()
        self._enabled = self._resumed = False
        self._unsure = True
        """Whether no stage sample has come since the last command."""

    def hear(self, feed: Feed) -> None:
        """Take samples from a feed from now on."""
        self._feed = feed
        self._heard_ns = self._clock.now_ns()

    @property
    def path_mm(self) -> float:
        """Length of the path in the tissue, by the stage."""
        return self.stage.depth_mm - self.options.entry_depth_mm if self.stage else math.nan

    @property
    def roll_rad(self) -> float:
        """Roll of the base: 0 bends to the left."""
        return self.stage.roll_rad - self.options.roll_left_rad if self.stage else math.nan

    @property
    def bevel(self) -> int:
        """Side to which the tip bends: +1 left, -1 right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def tip(self) -> TipEstimate:
        """The tip. Raises DeviceFault where it is not known."""
        assert self.filter is not None
        tip = self.filter.tip
        if tip.status is TipStatus.LOST:
            raise DeviceFault("tracker: what it sees contradicts the path, or the tip is not known well enough")
        return tip

    def enable(self) -> None:
        """Let the guard carry out commands; waits until nothing is against it. Raises MotionRefused."""
        self._guard.order(Order.HOME, _LOOP)
        end_ns = self._clock.now_ns() + round(self.options.silence_s * 1e9)
        while self._guard.state.present and self._clock.now_ns() < end_ns:
            self.listen()
        self._guard.order(Order.ENABLE, _LOOP)
        self._enabled = True

    def listen(self) -> None:
        """Take one sample. Raises Stopped where the operator wants that, DeviceFault of devices, silence and guard."""
        if self.stop_cause:
            raise Stopped(self.stop_cause)
        assert self._feed is not None
        try:
            sample = self._feed.next(_TURN_S)
        except DeviceFault as fault:
            if self._feed.failed is not None:
                self._guard.device_failed(self._feed.failed, fault)
            raise
        now_ns = self._clock.now_ns()
        if sample is not None:
            self._heard_ns = now_ns
            self._take(sample)
        elif (now_ns - self._heard_ns) * 1e-9 >= self.options.silence_s:
            raise DeviceFault(f"no device has said anything for {self.options.silence_s:g} s")
        if now_ns - self._ticked_ns >= _TICK_NS:
            self._ticked_ns = now_ns
            for listener in self._listeners:
                if (status := listener.status()) is not None:
                    self._guard.observe_recording(status)
            self._guard.tick()
        if self._enabled and self._guard.state.operating in (OperatingState.FAULT, OperatingState.DISABLED):
            raise DeviceFault(self._why_stopped())

    def listen_until(self, done: Callable[[], bool], limit_s: float, what: str) -> None:
        """Take samples until something is so; pauses do not count. Raises DeviceFault after `limit_s`."""
        end_ns = self._clock.now_ns() + round(limit_s * 1e9)
        while not done():
            if self._clock.now_ns() > end_ns:
                raise DeviceFault(f"{what} not within {limit_s:.3g} s")
            self.listen()
            if self._paused:
                end_ns += self._wait_out()

    def settle(self, frames: int) -> None:
        """Take samples until the tracker has seen the tip another `frames` times."""
        enough = self.frames + frames
        limit_s = self.options.silence_s + frames * 0.5
        self.listen_until(lambda: self.frames >= enough, limit_s, "tracker: no good frames")

    def begin_insert(self, path_mm: float) -> None:
        """Begin to insert to a length of the path. Raises DeviceFault."""
        if self._paused:
            self._wait_out()
        self._resumed, self._unsure = False, True
        options = self.options
        depth = path_mm + options.entry_depth_mm
        self._guard.insert(depth, options.velocity_mm_s)
        self.goal_mm, self.moved = path_mm, True
        self._tell(CommandKind.INSERT, depth, options.velocity_mm_s)

    def finish_insert(self, early_mm: float = 0.0) -> None:
        """Wait until the stage has come to rest where it was sent to, or has only `early_mm` to go."""
        goal, way = self.goal_mm, abs(self.goal_mm - self.path_mm)
        limit_s = _PATIENCE * way / self.options.velocity_mm_s + _GRACE_S

        def there() -> bool:
            if self._resumed:
                self.begin_insert(goal)
            if self._unsure or self.stage is None:
                return False
            left = goal - self.path_mm
            return 0 < left <= early_mm or (not self.stage.moving and abs(left) <= _DEPTH_MM)

        self.listen_until(there, limit_s, f"stage: came to rest at {goal:.4g} mm")
        if self.stage is not None and not self.stage.moving:
            self.goal_mm = self.path_mm  # what is left of it belongs to the next step

    def rotate(self, roll_rad: float) -> None:
        """Turn the base so that the tip comes to a roll: beyond it by the torsional lag, and back. Raises DeviceFault.

        0 bends to the left.
        """
        options = self.options
        goals = [roll_rad]
        if options.torsion is not None:
            inside = max(self.path_mm, 0.0)
            outside = max(options.needle_length_mm - inside, 0.0)
            if options.torsion.lag_rad(outside, inside) > _ROLL_RAD / 10:
                turning = options.torsion.compensated_rad(self.roll_rad, roll_rad, outside, inside)
                goals = turning[1:].tolist()
        for goal in goals:
            self._turn(float(goal) + options.roll_left_rad)

    def halt(self, *, latch: bool) -> None:
        """Stop both axes and disable the stage, whatever happened before; latched, a person must reset it."""
        self._enabled = False
        if latch:
            self._guard.stop()
        else:
            self._guard.order(Order.DISABLE, _LOOP)
        self._tell(CommandKind.STOP, math.nan, math.nan)

    @property
    def _paused(self) -> bool:
        return self._enabled and self._guard.state.operating is OperatingState.PAUSED

    def _wait_out(self) -> int:
        """Wait until nothing is against resuming, resume, and return how long it took, ns. Raises DeviceFault."""
        began_ns = self._clock.now_ns()
        causes = _causes(self._guard.state)
        self.on_pause(causes, "the needle stands")
        while self._guard.state.present or (self.stage is not None and self.stage.moving):
            if (self._clock.now_ns() - began_ns) * 1e-9 >= self.options.resume_s:
                raise DeviceFault(f"paused for {self.options.resume_s:g} s: {_causes(self._guard.state) or causes}")
            self.listen()
        self._guard.order(Order.RESUME, _LOOP)
        self._resumed = True
        self.on_pause("", "the needle goes on")
        return self._clock.now_ns() - began_ns

    def _why_stopped(self) -> str:
        """Return the causes of the guard, and what the device said that raised them, if it did."""
        assert self._feed is not None
        causes = f"stopped: {_causes(self._guard.state)}"
        try:
            for _ in range(_LAST_WORDS):
                self._feed.next(0.0)
        except DeviceFault as fault:
            return f"{fault}; {causes}"
        return causes

    def _turn(self, goal_rad: float) -> None:
        options, stage = self.options, self.stage
        assert stage is not None
        limit_s = _PATIENCE * abs(goal_rad - stage.roll_rad) / options.velocity_rad_s + _GRACE_S

        def begin() -> None:
            if self._paused:
                self._wait_out()
            self._guard.rotate(goal_rad, options.velocity_rad_s)
            self.moved, self._resumed, self._unsure = True, False, True
            self._tell(CommandKind.ROTATE, goal_rad, options.velocity_rad_s)

        def there() -> bool:
            if self._resumed:
                begin()
            now = self.stage
            if self._unsure or now is None:
                return False
            return not now.moving and abs(now.roll_rad - goal_rad) <= _ROLL_RAD

        begin()
        self.listen_until(there, limit_s, f"stage: came to rest at a roll of {goal_rad:.4g} rad")

    def _take(self, sample: Sample) -> None:
        for listener in self._listeners:
            listener.sample(sample)
        if isinstance(sample, StageSample):
            self.stage, self._unsure = sample, False
            if self.filter is not None:
                self.filter.predict(self._from_entry(sample))
        elif isinstance(sample, ForceSample):
            self.force = sample
            self._guard.observe(sample)
        else:
            self._take_pose(sample)

    def _take_pose(self, sample: PoseSample) -> None:
        self.pose = sample
        if self.filter is None:
            self.frames += sample.health is Health.GOOD
            self._guard.observe(sample)
            return
        if self.filter.update(sample) in (PoseUse.USED, PoseUse.WITHDRAWN):
            self.frames += 1
        tip = self.filter.tip
        known = tip.status is not TipStatus.LOST
        self._guard.observe(sample, tip_mm=(tip.x_mm, tip.y_mm) if known else None, out_of_plane_mm=tip.z_mm)
        for listener in self._listeners:
            listener.tip(sample.stamp.received_ns, self.path_mm, tip)

    def _from_entry(self, sample: StageSample) -> StageSample:
        """Return the sample with its depth counted from the entry and its roll from the left."""
        options = self.options
        if not (options.entry_depth_mm or options.roll_left_rad):
            return sample
        return replace(
            sample, depth_mm=sample.depth_mm - options.entry_depth_mm, roll_rad=sample.roll_rad - options.roll_left_rad
        )

    def _tell(self, kind: CommandKind, goal: float, speed: float) -> None:
        command = Command(self._clock.now_ns(), kind, goal, speed)
        for listener in self._listeners:
            listener.command(command)


def _causes(state: SafetyState) -> str:
    return ", ".join(sorted(state.present | state.latched))


def _unheard(causes: str, text: str) -> None:
    """Nobody wants to know of pauses."""
    _ = causes, text
