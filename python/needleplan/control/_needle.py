"""State of the needle: the last sample of each device and the tip filter. Only this module reads the feed.

Samples are processed in the order of their arrival. The same samples lead to the same decisions, so a recording can be
replayed.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

from needleplan.control._events import Listener
from needleplan.control._options import Options
from needleplan.control.safety import GuardedStage
from needleplan.devices import (
    Clock,
    Feed,
    FibreSample,
    ForceSample,
    Health,
    ImageSample,
    PoseSample,
    Sample,
    Source,
    StageSample,
    VirtualClock,
)
from needleplan.errors import DeviceFault
from needleplan.estimation.tip import PoseUse, TipEstimate, TipFilter, TipStatus

__all__ = ["NeedleState", "Stopped", "present_causes"]

# longest wait (s) for a sample; then the loop checks whether the operator or the guard has stopped the run
_TURN_S = 0.02
# largest number of waiting samples that are read from the feed to reach the fault that stopped the run
_MOST_WAITING = 100
# largest number of turns for which the fault of a failed reading is awaited, since another thread passes it on
_FAULT_TURNS = 5
# distance (mm) of the stage after which the predicted tip is validated between two frames of the tracker
_CHECK_MM = 0.1
# ns between two calls of the guard's `tick`, which sends the heartbeat to the stage: in real time a sixth of the
# watchdog time of a robot (30 ms), so that four heartbeats in succession may be lost; in simulated time none is lost
_TICK_NS, _SIMULATED_TICK_NS = 5_000_000, 10_000_000
# devices that only improve the tip, by their samples: the guard does not watch them, this loop does
_IMPROVING: dict[type[Sample], Source] = {FibreSample: Source.FIBRE, ImageSample: Source.IMAGE}


class Stopped(Exception):
    """Raised in the loop if the operator has stopped the run."""


class NeedleState:
    """Last sample of each device and the estimated tip; `receive` updates them with the next sample."""

    def __init__(
        self,
        guard: GuardedStage,
        clock: Clock,
        options: Options,
        listeners: Sequence[Listener],
        off_plan_mm: Callable[[TipEstimate], float],
    ) -> None:
        self.stage: StageSample | None = None
        self.force: ForceSample | None = None
        self.pose: PoseSample | None = None
        self.frames = 0
        """Number of usable tracker frames so far; after `follow`, only frames that the tip filter uses or withdraws
        count."""

        self.stage_samples = 0
        """Number of stage samples so far."""

        self._guard, self._clock, self._options, self._listeners = guard, clock, options, listeners
        self._off_plan_mm = off_plan_mm
        self.last_tip_mm: tuple[float, float, float] | None = None
        """Last tip (mm) that the guard has validated; None if it is not known."""

        self._checked_mm = -math.inf
        self._filter: TipFilter | None = None
        self._feed: Feed | None = None
        self._improved_ns: dict[Source, int] = {}
        self.measured: StageSample | None = None
        """Last stage sample, also of the time after the end of the run."""

        self.stop_cause = ""
        """Why the operator has stopped the run; empty if nobody has."""

        self._received_ns = self._ticked_ns = clock.now_ns()
        self._tick_ns = _SIMULATED_TICK_NS if isinstance(clock, VirtualClock) else _TICK_NS

    def open(self, feed: Feed, sources: Collection[Source]) -> None:
        """Receive samples of `sources` from `feed` from now on."""
        self._feed = feed
        self._received_ns = self._clock.now_ns()
        self._improved_ns = {source: self._received_ns for source in _IMPROVING.values() if source in sources}

    def follow(self, tip_filter: TipFilter) -> None:
        """Estimate the tip with `tip_filter` from now on."""
        self._filter = tip_filter

    def request_stop(self, cause: str) -> None:
        """Make the next `receive` raise Stopped with `cause`, or with the cause of an earlier request. Thread-safe."""
        self.stop_cause = self.stop_cause or cause or "stopped"

    @property
    def path_mm(self) -> float:
        """Path length in the tissue (mm), computed from the depth of the stage; NaN before the first stage sample."""
        return self.stage.depth_mm - self._options.entry_depth_mm if self.stage else math.nan

    @property
    def roll_rad(self) -> float:
        """Roll of the base (rad); at 0 the needle bends to the left. NaN before the first stage sample."""
        return self.stage.roll_rad - self._options.roll_left_rad if self.stage else math.nan

    @property
    def bevel(self) -> int:
        """Side to which the tip bends: +1 left, -1 right."""
        return 1 if math.cos(self.roll_rad) >= 0 else -1

    @property
    def tip(self) -> TipEstimate:
        """Estimate of the tip; available after `follow`. Raises DeviceFault if the filter has lost the tip."""
        return self.tip_ahead(0.0)

    def tip_ahead(self, length_mm: float) -> TipEstimate:
        """Return the estimate after a further insertion by `length_mm` without rotation; errors as `tip`."""
        assert self._filter is not None
        tip = self._filter.tip_ahead(length_mm)
        if tip.status is TipStatus.LOST:
            raise DeviceFault(
                "tracker: the tip is lost; its poses contradict the inserted length, or the estimate is too uncertain"
            )
        return tip

    def curvature_ahead(self, length_mm: float) -> tuple[float, float]:
        """Return the expected mean curvature (1/mm) over the next length of path, and its standard deviation."""
        assert self._filter is not None
        return self._filter.mean_curvature(length_mm)

    def receive(self) -> None:
        """Wait at most 20 ms for the next sample, process it, and call the guard's `tick` if that is due.

        Raises Stopped if the operator has stopped the run, and DeviceFault if a device fails, or if no device, the
        curvature sensors or the probe have sent no sample for `silence_s`.
        """
        if self.stop_cause:
            raise Stopped(self.stop_cause)
        assert self._feed is not None
        sample = self._feed.next(_TURN_S)
        now_ns = self._clock.now_ns()
        if sample is not None:
            self._received_ns = now_ns
            if (improving := _IMPROVING.get(type(sample))) is not None:
                self._improved_ns[improving] = now_ns
            self._take(sample)
        elif (now_ns - self._received_ns) * 1e-9 >= self._options.silence_s:
            raise DeviceFault(f"no device has sent a sample for {self._options.silence_s:g} s")
        for source, last_ns in self._improved_ns.items():
            if (now_ns - last_ns) * 1e-9 >= self._options.silence_s:
                raise DeviceFault(f"{source}: no sample for {self._options.silence_s:g} s")
        if now_ns - self._ticked_ns >= self._tick_ns:
            self._ticked_ns = now_ns
            for listener in self._listeners:
                if (status := listener.status()) is not None:
                    self._guard.observe_recording(status)
            self._guard.tick()

    def attend(self) -> None:
        """Wait at most 20 ms for a stage sample and call the guard's `tick`, after the end of a run.

        Faults of devices are ignored: the guard knows them, and a retraction goes on in spite of them. After the end of
        the feed, the stage is measured directly.
        """
        try:
            if self._feed is None or self._guard.stage_has_failed:
                sample: Sample | None = self._guard.measure(_TURN_S)
            else:
                sample = self._feed.next(_TURN_S)
        except DeviceFault:
            sample = None
            self._clock.sleep(_TURN_S)
        if sample is not None:
            self._publish(sample)
        with contextlib.suppress(DeviceFault):
            self._guard.tick()

    def why_stopped(self) -> str:
        """Return a message about a stop by the guard: the causes and, if a device has failed, its fault.

        Samples that still wait in the feed are passed to the listeners, because one of them may have caused the stop.
        """
        assert self._feed is not None
        causes = f"stopped: {present_causes(self._guard)}"
        try:
            for _ in range(_MOST_WAITING):
                if (sample := self._feed.next(0.0)) is not None:
                    self._publish(sample)
            # The guard knows of a failed reading before the thread that reads has passed the fault on.
            for _ in range(_FAULT_TURNS if self._guard.stage_has_failed else 0):
                if (sample := self._feed.next(_TURN_S)) is not None:
                    self._publish(sample)
        except DeviceFault as fault:
            return f"{fault}; {causes}"
        return f"{self._guard.reason}; {causes}" if self._guard.reason else causes

    def _publish(self, sample: Sample) -> None:
        if isinstance(sample, StageSample):
            self.measured = sample
        for listener in self._listeners:
            listener.sample(sample)

    def _take(self, sample: Sample) -> None:
        self._publish(sample)
        if isinstance(sample, StageSample):
            self.stage = sample
            self.stage_samples += 1
            if self._filter is not None:
                self._filter.predict(self._from_entry(sample))
                if abs(sample.depth_mm - self._checked_mm) >= _CHECK_MM:
                    self._validate_tip(self._filter.tip)
        elif isinstance(sample, ForceSample):
            self.force = sample
        elif isinstance(sample, PoseSample):
            self._take_pose(sample)
        elif self._filter is not None and isinstance(sample, FibreSample):
            self._filter.update_fibre(sample)
        elif self._filter is not None and isinstance(sample, ImageSample):
            self._filter.update_image(sample)

    def _take_pose(self, sample: PoseSample) -> None:
        gate = self._options.gate
        if gate is not None and gate.off_mm(sample.stamp.received_ns * 1e-9) > gate.within_mm:
            if self._filter is not None and sample.health is Health.GOOD:
                self._validate_tip(self._filter.tip)  # breathing has moved the needle with the tissue
            return
        self.pose = sample
        usable = sample.health is Health.GOOD
        if self._filter is None:
            self.frames += usable
            return
        if self._filter.update(sample) in (PoseUse.USED, PoseUse.WITHDRAWN):
            self.frames += 1
        tip = self._filter.tip
        if usable:
            self._validate_tip(tip)
        for listener in self._listeners:
            listener.tip(sample.stamp.received_ns, self.path_mm, tip)

    def _validate_tip(self, tip: TipEstimate) -> None:
        """Let the guard validate the estimated tip, at every frame and every 0.1 mm of the motion."""
        self._checked_mm = math.inf if self.stage is None else self.stage.depth_mm
        self.last_tip_mm = place = None if tip.status is TipStatus.LOST else tip.position_mm
        self._guard.observe_tip(place and place[:2], self._off_plan_mm(tip))

    def _from_entry(self, sample: StageSample) -> StageSample:
        """Return the sample with its depth relative to the entry and its roll relative to the roll that bends left."""
        options = self._options
        if not (options.entry_depth_mm or options.roll_left_rad):
            return sample
        return replace(
            sample, depth_mm=sample.depth_mm - options.entry_depth_mm, roll_rad=sample.roll_rad - options.roll_left_rad
        )


def present_causes(guard: GuardedStage) -> str:
    """Return the names of all present and latched causes of `guard`; those that stopped the needle are the first."""
    state = guard.state
    later = sorted((state.present | state.latched) - state.first)
    first = ", ".join(sorted(state.first)) or ", ".join(later)
    return f"{first}; then {', '.join(later)}" if state.first and later else first
