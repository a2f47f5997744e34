"""State of the needle: the last sample of each device, the tip filter, and the one place where the loop takes samples.

The loop is driven by samples in the order of their arrival. The same samples lead to the same decisions; a replay
depends on that.
"""

from __future__ import annotations

import math
from dataclasses import replace

from needleplan.control._events import ListenerGroup
from needleplan.control._options import Options
from needleplan.control.safety import GuardedStage
from needleplan.devices import Clock, Feed, ForceSample, Health, PoseSample, Sample, StageSample
from needleplan.errors import DeviceFault
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipStatus

__all__ = ["NeedleState", "Stopped", "present_causes"]

# s that the loop waits for a sample before it looks at the operator's stop and at the guard
_TURN_S = 0.02
# samples that may wait in the feed before the fault that the guard already knows of
_MOST_WAITING = 100
# ns between two ticks of the guard, which send the heartbeat of the stage
_TICK_NS = 10_000_000


class Stopped(Exception):
    """The operator has stopped the run."""


class NeedleState:
    """Last sample of each device and the estimated tip; `receive` takes the next sample of the feed."""

    def __init__(self, guard: GuardedStage, clock: Clock, options: Options, listeners: ListenerGroup) -> None:
        self.stage: StageSample | None = None
        self.force: ForceSample | None = None
        self.pose: PoseSample | None = None
        self.frames = 0
        """Number of usable frames of the tracker so far."""

        self.stage_samples = 0
        """Number of stage samples so far."""

        self._guard, self._clock, self._options, self._listeners = guard, clock, options, listeners
        self._filter: TipFilter | None = None
        self._feed: Feed | None = None
        self._stop_cause = ""
        self._received_ns = self._ticked_ns = clock.now_ns()

    def open(self, feed: Feed) -> None:
        """Take samples from `feed` from now on."""
        self._feed = feed
        self._received_ns = self._clock.now_ns()

    def follow(self, tip_filter: TipFilter) -> None:
        """Estimate the tip with `tip_filter` from now on."""
        self._filter = tip_filter

    def request_stop(self, cause: str) -> None:
        """Let the next `receive` raise Stopped; the first cause counts. Any thread may call it."""
        self._stop_cause = self._stop_cause or cause or "stopped"

    @property
    def path_mm(self) -> float:
        """Length of the path in the tissue, by the stage (mm)."""
        return self.stage.depth_mm - self._options.entry_depth_mm if self.stage else math.nan

    @property
    def roll_rad(self) -> float:
        """Roll of the base (rad); at 0 the needle bends to the left."""
        return self.stage.roll_rad - self._options.roll_left_rad if self.stage else math.nan

    @property
    def bevel(self) -> int:
        """Side to which the tip bends: +1 left, -1 right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def tip(self) -> TipEstimate:
        """Estimate of the tip. Raises DeviceFault if it is lost."""
        assert self._filter is not None
        tip = self._filter.tip
        if tip.status is TipStatus.LOST:
            raise DeviceFault(
                "tracker: the tip is lost; its poses contradict the inserted length, or the estimate is too uncertain"
            )
        return tip

    def receive(self) -> None:
        """Take one sample. Raises Stopped if the operator stops the run, and DeviceFault if no device sends samples."""
        if self._stop_cause:
            raise Stopped(self._stop_cause)
        assert self._feed is not None
        sample = self._feed.next(_TURN_S)
        now_ns = self._clock.now_ns()
        if sample is not None:
            self._received_ns = now_ns
            self._take(sample)
        elif (now_ns - self._received_ns) * 1e-9 >= self._options.silence_s:
            raise DeviceFault(f"no device has sent a sample for {self._options.silence_s:g} s")
        if now_ns - self._ticked_ns >= _TICK_NS:
            self._ticked_ns = now_ns
            for status in self._listeners.statuses():
                self._guard.observe_recording(status)
            self._guard.tick()

    def why_stopped(self) -> str:
        """Return why the guard stopped the run: its causes, after the fault message of the device if there is one.

        Waiting samples are passed to the listeners: the guard has validated them, and one may have caused the stop.
        """
        assert self._feed is not None
        causes = f"stopped: {present_causes(self._guard)}"
        try:
            for _ in range(_MOST_WAITING):
                if (sample := self._feed.next(0.0)) is not None:
                    self._listeners.sample(sample)
        except DeviceFault as fault:
            return f"{fault}; {causes}"
        return causes

    def _take(self, sample: Sample) -> None:
        self._listeners.sample(sample)
        if isinstance(sample, StageSample):
            self.stage = sample
            self.stage_samples += 1
            if self._filter is not None:
                self._filter.predict(self._from_entry(sample))
        elif isinstance(sample, ForceSample):
            self.force = sample
        else:
            self._take_pose(sample)

    def _take_pose(self, sample: PoseSample) -> None:
        self.pose = sample
        usable = sample.health is Health.GOOD
        if self._filter is None:
            self.frames += usable
            return
        if self._filter.update(sample) in (PoseUse.USED, PoseUse.WITHDRAWN):
            self.frames += 1
        tip = self._filter.tip
        if usable:
            known = tip.status is not TipStatus.LOST
            self._guard.observe_tip((tip.x_mm, tip.y_mm) if known else None, tip.z_mm)
        self._listeners.tip(sample.stamp.received_ns, self.path_mm, tip)

    def _from_entry(self, sample: StageSample) -> StageSample:
        """Return the sample with the depth counted from the entry and the roll from the left."""
        options = self._options
        if not (options.entry_depth_mm or options.roll_left_rad):
            return sample
        return replace(
            sample, depth_mm=sample.depth_mm - options.entry_depth_mm, roll_rad=sample.roll_rad - options.roll_left_rad
        )


def present_causes(guard: GuardedStage) -> str:
    """Return the causes that are present or latched, as text."""
    return ", ".join(sorted(guard.state.present | guard.state.latched))
