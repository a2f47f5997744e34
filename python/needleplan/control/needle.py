"""The needle as the loop has it: moved by the stage, seen by the tracker, one sample at a time.

All that happens is driven by samples in the order of their arrival: the same samples make the same decisions, which is
what a replay relies on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

from needleplan.control.listening import Command, CommandKind, Listener
from needleplan.control.options import Options
from needleplan.control.station import Feed, Station
from needleplan.devices import ForceSample, Health, PoseSample, StageSample
from needleplan.errors import DeviceFault
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipStatus

__all__ = ["Needle", "Stopped"]

_DEPTH_MM, _ROLL_RAD = 0.3, 0.02
"""How near to its goal a stage must have come to rest."""

_PATIENCE = 2.0
_GRACE_S = 2.0
"""A move may take this many times as long as it should, and this much longer."""


class Stopped(Exception):
    """The operator wants the needle to stop."""


class Needle:
    """Reads the devices, keeps the last sample of each, follows the tip, and carries out moves."""

    def __init__(self, station: Station, feed: Feed, options: Options, listeners: Sequence[Listener]) -> None:
        self.station = station
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
        self._feed = feed
        self._listeners = listeners
        self._silent_since_ns = station.clock.now_ns()

    @property
    def path_mm(self) -> float:
        """Length of the path in the tissue, by the stage."""
        return self.stage.depth_mm - self.options.entry_depth_mm if self.stage else math.nan

    @property
    def bevel(self) -> int:
        """Side to which the tip bends: +1 left, -1 right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def roll_rad(self) -> float:
        """Roll of the base: 0 bends to the left."""
        return self.stage.roll_rad - self.options.roll_left_rad if self.stage else math.nan

    @property
    def tip(self) -> TipEstimate:
        """The tip. Raises DeviceFault where it is not known."""
        assert self.filter is not None
        tip = self.filter.tip
        if tip.status is TipStatus.LOST:
            raise DeviceFault("tracker: what it sees contradicts the path, or the tip is not known well enough")
        return tip

    def listen(self) -> None:
        """Take one sample. Raises Stopped where the operator wants that, DeviceFault of the devices or of silence."""
        if self.stop_cause:
            raise Stopped(self.stop_cause)
        sample = self._feed.next(self.options.silence_s)
        now_ns = self.station.clock.now_ns()
        if sample is None:
            if (now_ns - self._silent_since_ns) * 1e-9 >= self.options.silence_s:
                raise DeviceFault(f"no device has said anything for {self.options.silence_s:g} s")
            return
        self._silent_since_ns = now_ns
        for listener in self._listeners:
            listener.sample(sample)
        if isinstance(sample, StageSample):
            self._take_stage(sample)
        elif isinstance(sample, ForceSample):
            self.force = sample
        else:
            self._take_pose(sample)

    def listen_until(self, done: Callable[[], bool], limit_s: float, what: str) -> None:
        """Take samples until something is so. Raises DeviceFault after `limit_s` of the time of the samples."""
        clock = self.station.clock
        end_ns = clock.now_ns() + round(limit_s * 1e9)
        while not done():
            if clock.now_ns() > end_ns:
                raise DeviceFault(f"{what} not within {limit_s:.3g} s")
            self.listen()

    def settle(self, frames: int) -> None:
        """Take samples until the tracker has seen the tip another `frames` times."""
        enough = self.frames + frames
        self.listen_until(
            lambda: self.frames >= enough, self.options.silence_s + frames * 0.5, "tracker: no good frames"
        )

    def begin_insert(self, path_mm: float) -> None:
        """Begin to insert to a length of the path. Raises DeviceFault."""
        options = self.options
        depth = path_mm + options.entry_depth_mm
        self.station.stage.insert(depth, options.velocity_mm_s)
        self.goal_mm = path_mm
        self._tell(CommandKind.INSERT, depth, options.velocity_mm_s)

    def finish_insert(self, early_mm: float = 0.0) -> None:
        """Wait until the stage has come to rest where it was sent to, or has only `early_mm` to go."""
        goal, way = self.goal_mm, abs(self.goal_mm - self.path_mm)
        limit_s = _PATIENCE * way / self.options.velocity_mm_s + _GRACE_S

        def there() -> bool:
            stage = self.stage
            if stage is None:
                return False
            left = goal - self.path_mm
            return 0 < left <= early_mm or (not stage.moving and abs(left) <= _DEPTH_MM)

        self.listen_until(there, limit_s, f"stage: came to rest at {goal:.4g} mm")

    def rotate(self, roll_rad: float) -> None:
        """Turn the base so that the tip comes to a roll: beyond it by the torsional lag, and back. Raises DeviceFault.

        0 bends to the left.
        """
        options = self.options
        goals = [roll_rad]
        lag = self._lag_rad()
        if lag > _ROLL_RAD / 10:
            assert options.torsion is not None
            outside, inside = self._lengths()
            goals = options.torsion.compensated_rad(self.roll_rad, roll_rad, outside, inside)[1:].tolist()
        for goal in goals:
            self._turn(float(goal) + options.roll_left_rad)

    def halt(self) -> None:
        """Stop both axes, whatever happened before."""
        self.station.stage.stop()
        self._tell(CommandKind.STOP, math.nan, math.nan)

    def _turn(self, goal_rad: float) -> None:
        options, stage = self.options, self.stage
        assert stage is not None
        self.station.stage.rotate(goal_rad, options.velocity_rad_s)
        self._tell(CommandKind.ROTATE, goal_rad, options.velocity_rad_s)
        limit_s = _PATIENCE * abs(goal_rad - stage.roll_rad) / options.velocity_rad_s + _GRACE_S

        def there() -> bool:
            now = self.stage
            return now is not None and not now.moving and abs(now.roll_rad - goal_rad) <= _ROLL_RAD

        self.listen_until(there, limit_s, f"stage: came to rest at a roll of {goal_rad:.4g} rad")

    def _take_stage(self, sample: StageSample) -> None:
        self.stage = sample
        if sample.health is not Health.GOOD:
            raise DeviceFault(f"stage: a sample is {sample.health}: {'; '.join(sample.notes) or 'no reason given'}")
        if self.filter is not None:
            self.filter.predict(self._from_entry(sample))

    def _take_pose(self, sample: PoseSample) -> None:
        self.pose = sample
        if sample.health is not Health.GOOD:
            return
        if self.filter is None:
            self.frames += 1
            return
        if self.filter.update(sample) in (PoseUse.USED, PoseUse.WITHDRAWN):
            self.frames += 1
        tip = self.filter.tip
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

    def _lengths(self) -> tuple[float, float]:
        inside = max(self.path_mm, 0.0)
        return max(self.options.needle_length_mm - inside, 0.0), inside

    def _lag_rad(self) -> float:
        torsion = self.options.torsion
        return torsion.lag_rad(*self._lengths()) if torsion else 0.0

    def _tell(self, kind: CommandKind, goal: float, speed: float) -> None:
        command = Command(self.station.clock.now_ns(), kind, goal, speed)
        for listener in self._listeners:
            listener.command(command)
