"""The insertion loop, which looks up the action for the estimated tip in the table and carries the action out.

If the needle need not stop, the decision is made shortly before the end of a step, for the predicted pose at the end of
the step. Before a rotation the needle stops, the tracker observes the tip again, and the decision is made for the pose
at rest. The last step ends at the point of the arc that is closest to the centre of the target. What a decision means
in the plane or in 3D is the matter of a `PlanGuidance`.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import singledispatch

import numpy as np

from needleplan.control._driver import NeedleDriver, Retracted
from needleplan.control._events import ExecutedStep, Listener, RunEvent, RunEventName
from needleplan.control._guidance import PlanGuidance, RunEnd, StepChoice
from needleplan.control._needle import NeedleState, Stopped
from needleplan.control._options import Options, planned_tip_settings
from needleplan.control._plane_guidance import PlaneGuidance
from needleplan.control._preconditions import measured_entry, require_expected
from needleplan.control._replanning import FROM_TABLE_SET, Replanner, ThreadReplanner, curvature_mismatch
from needleplan.control._report import InsertionOutcome, InsertionReport, InsertionTrace
from needleplan.control._scene import NEARLY_MM
from needleplan.control._space_guidance import SpaceGuidance
from needleplan.control.safety import Cause, GuardedStage, SafetyEvent, SafetyLimits
from needleplan.devices import Closing, Station, VirtualClock, no_long_collections, short_turns
from needleplan.errors import DeviceFault, InputError, NeedleplanError
from needleplan.estimation.registration import Registration, not_refused, require_verdict
from needleplan.estimation.tip import TipSettings
from needleplan.planning import PolicyTable, Pose, SpacePose, SpaceTable, Table
from needleplan.signals import Array
from needleplan.stopping import Rest

__all__ = ["Insertion", "guidance_by"]

# number of tracker frames over which the pose of the entry is averaged
_ENTRY_FRAMES = 10
# event that is emitted before END if the run ends with one of these outcomes; these outcomes also latch the stop
_ABORTED = {InsertionOutcome.FAULT: RunEventName.FAULT, InsertionOutcome.REFUSED: RunEventName.FAULT,
            InsertionOutcome.STOPPED: RunEventName.STOP}  # fmt: skip


class Insertion(Closing):
    """One insertion with a policy table. Call `run` once, then `close`.

    Parameters
    ----------
    table
        Policy table of the first plan, in the plane or in 3D.
    station
        The three devices and their clock. Closing the insertion closes the stage; the sensors stay open.
    options
        Speeds, conditions for replanning, and conditions for ending the insertion without success.
    registration
        Transformation from the tracker frame to the plan frame; the identity by default. A refused one is an error.
        Real devices (any clock but a VirtualClock) need one that has passed, or that a person accepts
        (`Registration.accepted`).
    tip_settings
        Settings of the tip filter; those of `planned_tip_settings` if None.
    limits
        Limits of the safety guard `insertion.guard`, through which a person can also retract the needle; the
        defaults of `SafetyLimits` if None.
    accepted_limits
        Why limits laxer than the defaults are accepted; needed if there are any. A recording contains the reason if
        `RunSetup.accepted` has it too.
    replanner
        Source of new tables; a `ThreadReplanner` by default.
    listeners
        Receivers of samples, estimates, commands, decisions and events.
    needs_deadman
        Whether the needle moves only while a person holds a deadman switch, whose signals `guard.observe_deadman`
        receives.
    on_alarm
        Function that is called once with MOVES if the needle moves in spite of a stop, and once with UNKNOWN if its
        rest is unknown. It must return at once.

    Raises
    ------
    MotionRefused
        If the stage already has a guard.
    SafetyError
        If limits are laxer than their defaults and no reason is given.
    DataError
        If the registration was refused, or has no verdict and the devices are real.

    """

    def __init__(
        self, table: Table, station: Station, options: Options | None = None, *,
        registration: Registration | None = None,
        tip_settings: TipSettings | None = None,
        limits: SafetyLimits | None = None,
        replanner: Replanner | None = None,
        listeners: Sequence[Listener] = (),
        needs_deadman: bool = False,
        accepted_limits: str = "",
        on_alarm: Callable[[Rest], object] | None = None,
    ) -> None:  # fmt: skip
        self.options: Options = options or Options()
        is_simulated = isinstance(station.clock, VirtualClock)
        accepted = not_refused if is_simulated else require_verdict
        self.registration: Registration = accepted(registration or Registration())
        self._station, self._tip_settings = station, tip_settings or planned_tip_settings(table)
        self._guidance = guidance_by(table, self.options)
        self._trace = InsertionTrace(self.options.force_axis)
        self._listeners = (self._trace, *listeners)
        self.guard: GuardedStage = GuardedStage(
            station.stage, limits, clock=station.clock, listener=self._on_safety, check_tip=self._check_tip,
            needs_deadman=needs_deadman, accepted_limits=accepted_limits, on_alarm=on_alarm,
        )  # fmt: skip
        self._needle = NeedleState(self.guard, station.clock, self.options, self._listeners, self._guidance.off_plan_mm)
        self._driver = NeedleDriver(self._needle, self.guard, station.clock, self.options, self._listeners, self._emit)
        self._replanner = replanner or ThreadReplanner(wait=isinstance(station.clock, VirtualClock))
        self._first = self._guidance
        self._planned_mm: Array = np.empty((0, 2))
        self._number = 0
        self._thread = 0

    @property
    def table(self) -> Table:
        """The present policy table."""
        return self._guidance.table

    def stop(self, cause: str) -> None:
        """Stop the needle and end the run with the outcome STOPPED.

        Any thread or signal handler may call this method. A stop is sent at once.
        """
        self._needle.request_stop(cause)
        if self._thread:
            with contextlib.suppress(DeviceFault):
                self.guard.send_stop()
        # A signal handler runs in the thread of the loop, which may hold the lock of the guard; then the loop stops.
        if self._thread and threading.get_ident() != self._thread:
            self.guard.stop()

    def close(self) -> None:
        """Stop the needle and close the stage. Closing twice is harmless."""
        self.guard.close()

    def run(self) -> InsertionReport:
        """Insert the needle, stop it, and return the report: the outcome, its cause, and whether the needle rests.

        A DeviceFault, an InputError and Ctrl-C end the run with an outcome; any other exception is raised after the
        stop.
        """
        outcome, cause = InsertionOutcome.FAULT, "the program ended"
        self._thread, rest = threading.get_ident(), Rest.UNKNOWN
        with ExitStack() as closing:
            closing.callback(self._replanner.close)
            if not isinstance(self._station.clock, VirtualClock):
                closing.enter_context(no_long_collections())
                closing.enter_context(short_turns())
            try:
                outcome, cause = self._run(closing)
            except Stopped as stopped:
                outcome, cause = InsertionOutcome.STOPPED, str(stopped)
            except KeyboardInterrupt:
                outcome, cause = InsertionOutcome.STOPPED, "interrupted by the operator"
            except (DeviceFault, InputError) as fault:
                outcome, cause = self._outcome_of(fault)
            finally:
                rest = self._halt(outcome, cause)
        errors = self._first.errors(self._trace.last, self._planned_mm)
        digest = self._first.table.digest
        report = self._trace.report(outcome, cause, errors, self._planned_mm, self._needle.path_mm, digest)
        return replace(report, rest=rest)

    def _outcome_of(self, fault: Exception) -> RunEnd:
        first = self.guard.state.first
        # A stop by another thread or a signal handler reaches guard and stage at once, often before the loop receives a
        # sample: the command that it has overtaken is refused.
        if self._needle.stop_cause and set(first) <= {Cause.STOP_ORDERED}:
            return InsertionOutcome.STOPPED, self._needle.stop_cause
        if first == {Cause.STOP_ORDERED}:
            return InsertionOutcome.STOPPED, "a stop was ordered at the guard"
        if not self._driver.has_moved():
            return InsertionOutcome.REFUSED, str(fault)
        tip_mm = self._needle.last_tip_mm
        if tip_mm is not None and Cause.IN_OBSTACLE in first:
            return InsertionOutcome.COLLISION, f"{self._guidance.place(tip_mm)}, in {self._guidance.touches(tip_mm)}"
        if tip_mm is not None and Cause.OUT_OF_WORKSPACE in first:
            return InsertionOutcome.OUTSIDE, f"{self._guidance.place(tip_mm)}, outside the workspace"
        return InsertionOutcome.FAULT, str(fault)

    def _check_tip(self, *_: float) -> frozenset[Cause]:
        """Return the causes of the present tip; the guard calls this for every estimate. Outside the tissue: none."""
        tip_mm = self._needle.last_tip_mm
        if tip_mm is None or not self._needle.path_mm > 0:
            return frozenset()
        if self._guidance.outside(tip_mm):
            return frozenset({Cause.OUT_OF_WORKSPACE})
        return frozenset({Cause.IN_OBSTACLE}) if self._guidance.touches(tip_mm) else frozenset()

    def _halt(self, outcome: InsertionOutcome, cause: str) -> Rest:
        rest = self._driver.halt(latch=outcome in _ABORTED)
        if outcome in _ABORTED:
            self._emit(_ABORTED[outcome], str(outcome), cause)
        self._emit(RunEventName.END, str(outcome), cause)
        return rest

    def _run(self, closing: ExitStack) -> RunEnd:
        self._emit(RunEventName.BEGIN, "operator", f"table {self.table.digest}", self.table.digest)
        self._station.force_sensor.bias()
        self._emit(RunEventName.BIAS, "begin", "the force at rest is zero")
        feed = self._station.feed(self.guard.read_device)
        closing.callback(feed.close)
        self._needle.open(feed, self._station.devices)
        try:
            ended = self._begin()
        except Retracted:
            ended = self._decide_anew()
        while ended is None:
            try:
                ended = self._outcome_at_tip() or self._step()
            except Retracted:
                ended = self._decide_anew()
        return ended

    def _decide_anew(self) -> RunEnd | None:
        """Forget the old goal after a retraction by a person, and observe the tip again; then the loop decides anew.

        Returns (outcome, cause) if the needle is out of the tissue, else None.
        """
        needle, driver = self._needle, self._driver
        driver.hold()
        self._emit(
            RunEventName.RETRACTED, "person", f"the path length is {needle.path_mm:.2f} mm; the old goal is void"
        )
        if needle.path_mm < -NEARLY_MM:
            return InsertionOutcome.STOPPED, "a person has pulled the needle out of the tissue"
        driver.settle(self.options.settling_frames)
        return None

    def _begin(self) -> RunEnd | None:
        """Measure the entry, enable the guard, insert to the entry, and turn the bevel as the plan begins.

        Returns (outcome, cause) before any motion if the success probability is below `least_success`, else None.
        """
        needle, driver, options = self._needle, self._driver, self.options
        driver.wait_until(lambda: needle.stage is not None, options.silence_s, "stage: no sample")
        entry = measured_entry(needle, driver, self.registration, _ENTRY_FRAMES, self.guard.limits.pose_age_s)
        require_expected(entry, needle.path_mm, options)
        sensors = (self._station.fibre, self._station.plane)
        needle.follow(self._guidance.tip_filter(self.registration, entry, self._tip_settings, *sensors))
        driver.settle(_ENTRY_FRAMES)
        start = self._guidance.begin(entry, needle)
        self._planned_mm = start.planned_mm
        if start.refused is not None:
            return start.refused
        driver.enable()
        if needle.path_mm < -NEARLY_MM:
            driver.begin_insert(0.0)
            driver.finish_insert()
            driver.settle(options.settling_frames)
        if start.roll_rad is not None:
            driver.rotate(start.roll_rad)
        driver.hold()
        return None

    def _outcome_at_tip(self) -> RunEnd | None:
        """Return (outcome, cause) if the position of the tip or the path length ends the insertion, else None."""
        tip, guidance, options = self._needle.tip, self._guidance, self.options
        place = guidance.place(tip.position_mm)
        if guidance.outside(tip.position_mm):
            return InsertionOutcome.OUTSIDE, f"{place}, outside the workspace"
        touched = guidance.touches(tip.position_mm)
        if touched:
            return InsertionOutcome.COLLISION, f"{place}, in {touched}"
        if self._needle.path_mm >= options.longest_mm - NEARLY_MM:
            return (
                InsertionOutcome.TOO_LONG,
                f"the path has reached the largest allowed length, {options.longest_mm:g} mm",
            )
        return None

    def _step(self) -> RunEnd | None:
        """Decide and carry out one step. Returns (outcome, cause) if the insertion has ended, else None.

        If the decision requires a needle at rest but the needle moves, the step only waits for rest and new frames.
        """
        self._take_table()
        room_mm = max(self.options.longest_mm - self._driver.goal_mm, 0.0)
        choice = self._guidance.choose(self._needle, self._remaining_mm(), room_mm)
        if choice.needs_rest:
            # These decisions are not made during a motion: the needle stops and is observed again.
            self._driver.finish_insert()
            self._driver.settle(self.options.settling_frames)
            return None
        if choice.end is not None:
            return choice.end
        self._record(choice)
        self._replan_if_needed(choice.pose)
        self._carry_out(choice)
        return None

    def _carry_out(self, choice: StepChoice) -> None:
        """Make the segments of a step; at the end of all but the last one, the needle comes to rest."""
        driver, options = self._driver, self.options
        for segment in choice.segments[:-1]:
            if segment.roll_rad is not None:
                driver.rotate(segment.roll_rad)
            driver.begin_insert(driver.goal_mm + segment.length_mm)
            driver.finish_insert()
        segment = choice.segments[-1]
        if segment.roll_rad is not None:
            driver.rotate(segment.roll_rad)
        driver.begin_insert(driver.goal_mm + segment.length_mm)
        if choice.last or options.stops:
            driver.finish_insert()
            driver.settle(options.settling_frames)
        else:
            driver.finish_insert(options.velocity_mm_s * options.lead_s)

    def _remaining_mm(self) -> float:
        return self._driver.goal_mm - self._needle.path_mm

    def _record(self, choice: StepChoice) -> None:
        needle, now_ns = self._needle, self._station.clock.now_ns()
        latency_s = (now_ns - needle.pose.stamp.received_ns) * 1e-9 if needle.pose else math.nan
        step = ExecutedStep(
            self._number, now_ns, self._driver.goal_mm, choice.pose, choice.state, choice.action, choice.value,
            choice.success, choice.length_mm, needle.tip, self.table.digest, latency_s,
        )  # fmt: skip
        self._number += 1
        for listener in self._listeners:
            listener.step(step)

    def _replan_if_needed(self, pose: Pose | SpacePose) -> None:
        """Request a new table if the curvature expected on the way differs too much from the planned one at `pose`."""
        if not self.options.replan or self._replanner.busy:
            return
        expected, sd, planned = self._guidance.mismatch(self._needle, pose)
        cause = curvature_mismatch(expected, sd, planned, self.options) if planned else ""
        if not cause:
            return
        try:
            scenario = self._guidance.rescaled(expected / planned, pose)
        except InputError as error:
            self._emit(RunEventName.REPLAN_REFUSED, cause, str(error))
            return
        self._emit(RunEventName.REPLAN_ASKED, cause, "planning again with the estimated curvature")
        self._replanner.ask(scenario)

    def _take_table(self) -> None:
        """Replace the table and its geometry if a new table is ready; emit an event if planning has failed."""
        try:
            table = self._replanner.take(self._number)
        except NeedleplanError as error:
            self._emit(RunEventName.REPLAN_REFUSED, "planner", str(error))
            return
        if table is not None:
            self._guidance = self._guidance.follow(table)
            radius, seconds = table.scenario.needle.curvature_radius_mm, table.stats.seconds
            source = self._replanner.source
            text = f"new table for a radius of {radius:.4g} mm, computed in {seconds:.3f} s"
            if source == FROM_TABLE_SET:
                text = f"stored table for a radius of {radius:.4g} mm, until the new one is computed"
            self._emit(RunEventName.TABLE_SWAPPED, source, text, table.digest)

    def _on_safety(self, event: SafetyEvent) -> None:
        for listener in self._listeners:
            listener.safety(event)

    def _emit(self, name: RunEventName, cause: str, text: str, digest: str = "") -> None:
        event = RunEvent(self._station.clock.now_ns(), name, cause, text, self._number, digest)
        for listener in self._listeners:
            listener.event(event)


@singledispatch
def guidance_by(table: Table, options: Options) -> PlanGuidance:
    """Return the guidance by a table, in the plane or in 3D."""
    raise NotImplementedError(type(table))


guidance_by.register(PolicyTable, PlaneGuidance)
guidance_by.register(SpaceTable, SpaceGuidance)
