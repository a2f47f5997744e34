"""The insertion loop, which looks up the action for the estimated tip in the table and carries the action out.

If the needle need not stop, the decision is made shortly before the end of a step, for the predicted pose at the end of
the step. Before a rotation the needle stops, the tracker observes the tip again, and the decision is made for the pose
at rest. The last step ends at the point of the arc that is closest to the centre of the target.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from contextlib import ExitStack

from needleplan.control._driver import NeedleDriver, Retracted
from needleplan.control._events import ExecutedStep, Listener, RunEvent, RunEventName
from needleplan.control._needle import NeedleState, Stopped
from needleplan.control._options import Options
from needleplan.control._plane import in_plane_per_mm, plane_roll_rad
from needleplan.control._preconditions import measured_entry, require_expected
from needleplan.control._replanning import Replanner, ThreadReplanner, curvature_mismatch, rescaled
from needleplan.control._report import InsertionOutcome, InsertionReport, InsertionTrace
from needleplan.control._scene import NEARLY_MM, Approach, ScenarioGeometry, state_of
from needleplan.control.safety import Cause, GuardedStage, SafetyEvent, SafetyLimits
from needleplan.devices import Closing, Station, VirtualClock, no_long_collections, short_turns
from needleplan.errors import DeviceFault, InputError, NeedleplanError
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipFilter, TipSettings
from needleplan.models import arc_step
from needleplan.planning import Action, Decision, Path, PolicyTable, Pose

__all__ = ["Insertion"]

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
        Policy table of the first plan.
    station
        The three devices and their clock. Closing the insertion closes the stage; the sensors stay open.
    options
        Speeds, conditions for replanning, and conditions for ending the insertion without success.
    registration
        Transformation from the tracker frame to the plan frame; the identity by default.
    tip_settings
        Settings of the tip filter; the defaults of `TipSettings` if None.
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

    Raises
    ------
    MotionRefused
        If the stage already has a guard.
    SafetyError
        If limits are laxer than their defaults and no reason is given.

    """

    def __init__(
        self, table: PolicyTable, station: Station, options: Options | None = None, *,
        registration: Registration | None = None,
        tip_settings: TipSettings | None = None,
        limits: SafetyLimits | None = None,
        replanner: Replanner | None = None,
        listeners: Sequence[Listener] = (),
        needs_deadman: bool = False,
        accepted_limits: str = "",
    ) -> None:  # fmt: skip
        self.table = table
        self.options = options or Options()
        self.registration = registration or Registration()
        self._station, self._tip_settings = station, tip_settings
        self._scene = ScenarioGeometry(table.scenario)
        self._trace = InsertionTrace(self.options.force_axis)
        self._listeners = (self._trace, *listeners)
        self.guard = GuardedStage(
            station.stage, limits, clock=station.clock, listener=self._on_safety, check_tip=self._check_tip,
            needs_deadman=needs_deadman, accepted_limits=accepted_limits,
        )  # fmt: skip
        self._needle = NeedleState(self.guard, station.clock, self.options, self._listeners)
        self._driver = NeedleDriver(self._needle, self.guard, station.clock, self.options, self._listeners, self._emit)
        self._replanner = replanner or ThreadReplanner(wait=isinstance(station.clock, VirtualClock))
        self._first_table = table
        self._planned: Path | None = None
        self._number = 0
        self._thread = 0
        self._plane_rad: float | None = None  # roll of the bevel out of the plane; None: never corrected
        # Cached attributes that take long to compute are computed here, before anything moves.
        _ = table.lattice, table.digest, self._scene.touches(0.0, 0.0)

    def stop(self, cause: str) -> None:
        """Stop the needle and end the run with the outcome STOPPED.

        Any thread or signal handler may call this method.
        """
        self._needle.request_stop(cause)
        # A signal handler runs in the thread of the loop, which may hold the lock of the guard; then the loop stops.
        if self._thread and threading.get_ident() != self._thread:
            self.guard.stop()

    def close(self) -> None:
        """Stop the needle and close the stage. Closing twice is harmless."""
        self.guard.close()

    def run(self) -> InsertionReport:
        """Insert the needle, stop it, and return the report, which contains the outcome and its cause.

        A DeviceFault, an InputError and Ctrl-C end the run with an outcome; any other exception is raised after the
        stop.
        """
        outcome, cause = InsertionOutcome.FAULT, "the program ended"
        self._thread = threading.get_ident()
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
                self._halt(outcome, cause)
        return self._trace.report(outcome, cause, self._first_table, self._planned, self._needle.path_mm)

    def _outcome_of(self, fault: Exception) -> tuple[InsertionOutcome, str]:
        if not self._driver.moved:
            return InsertionOutcome.REFUSED, str(fault)
        first = self.guard.state.first
        tip_mm = self._needle.last_tip_mm
        if tip_mm is not None and Cause.IN_OBSTACLE in first:
            return InsertionOutcome.COLLISION, f"{_place(*tip_mm)}, in {self._scene.touches(*tip_mm)}"
        if tip_mm is not None and Cause.OUT_OF_WORKSPACE in first:
            return InsertionOutcome.OUTSIDE, f"{_place(*tip_mm)}, outside the workspace"
        return InsertionOutcome.FAULT, str(fault)

    def _check_tip(self, x_mm: float, y_mm: float) -> frozenset[Cause]:
        """Return the causes of a tip position; the guard calls this for every estimate. Outside the tissue: none."""
        if not self._needle.path_mm > 0:
            return frozenset()
        if self._scene.outside(x_mm, y_mm):
            return frozenset({Cause.OUT_OF_WORKSPACE})
        return frozenset({Cause.IN_OBSTACLE}) if self._scene.touches(x_mm, y_mm) else frozenset()

    def _halt(self, outcome: InsertionOutcome, cause: str) -> None:
        self._driver.halt(latch=outcome in _ABORTED)
        if outcome in _ABORTED:
            self._emit(_ABORTED[outcome], str(outcome), cause)
        self._emit(RunEventName.END, str(outcome), cause)

    def _run(self, closing: ExitStack) -> tuple[InsertionOutcome, str]:
        self._emit(RunEventName.BEGIN, "operator", f"table {self.table.digest}", self.table.digest)
        self._station.force_sensor.bias()
        self._emit(RunEventName.BIAS, "begin", "the force at rest is zero")
        feed = self._station.feed(self.guard.read_device)
        closing.callback(feed.close)
        self._needle.open(feed)
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

    def _decide_anew(self) -> tuple[InsertionOutcome, str] | None:
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

    def _begin(self) -> tuple[InsertionOutcome, str] | None:
        """Measure the entry, enable the guard, insert to the entry, and turn the bevel to the side of the lower cost.

        Returns (outcome, cause) before any motion if the success probability is below `least_success`, else None.
        """
        needle, driver, options = self._needle, self._driver, self.options
        driver.wait_until(lambda: needle.stage is not None, options.silence_s, "stage: no sample")
        entry = measured_entry(needle, driver, self.registration, _ENTRY_FRAMES, self.guard.limits.pose_age_s)
        require_expected(entry, needle.path_mm, options)
        needle.follow(TipFilter.for_scenario(self._scene.scenario, self.registration, entry, self._tip_settings))
        driver.settle(_ENTRY_FRAMES)
        x, y = self._scene.clamped(*entry[:2])
        start = self.table.start((x, y, entry[2]))
        self._planned = self.table.path(start)
        decision = self.table.lookup(*start)
        if decision.success < options.least_success:
            return self._given_up(start, decision)
        driver.enable()
        if needle.path_mm < -NEARLY_MM:
            driver.begin_insert(0.0)
            driver.finish_insert()
            driver.settle(options.settling_frames)
        if start.bevel != needle.bevel:
            driver.rotate(0.0 if start.bevel > 0 else math.pi)
        driver.hold()
        return None

    def _outcome_at_tip(self) -> tuple[InsertionOutcome, str] | None:
        """Return (outcome, cause) if the position of the tip or the path length ends the insertion, else None."""
        tip, scene, options = self._needle.tip, self._scene, self.options
        place = _place(tip.x_mm, tip.y_mm)
        if scene.outside(tip.x_mm, tip.y_mm):
            return InsertionOutcome.OUTSIDE, f"{place}, outside the workspace"
        touched = scene.touches(tip.x_mm, tip.y_mm)
        if touched:
            return InsertionOutcome.COLLISION, f"{place}, in {touched}"
        if self._needle.path_mm >= options.longest_mm - NEARLY_MM:
            return (
                InsertionOutcome.TOO_LONG,
                f"the path has reached the largest allowed length, {options.longest_mm:g} mm",
            )
        return None

    def _step(self) -> tuple[InsertionOutcome, str] | None:
        """Decide and carry out one step. Returns (outcome, cause) if the insertion has ended, else None.

        If the decision requires a needle at rest but the needle moves, the step only waits for rest and new frames.
        """
        self._take_table()
        pose, scene, options = self._pose_at_goal(), self._scene, self.options
        tip = self._needle.tip
        approach = Approach(scene, in_plane_per_mm(tip))
        moving = self._remaining_mm() > NEARLY_MM
        inside, outside = approach.inside(pose), scene.outside(pose.x_mm, pose.y_mm)
        decision = None if inside or outside else self.table.lookup(*pose)
        hopeless = decision is not None and decision.success < options.least_success
        rotates = decision is not None and decision.action is Action.ROTATE
        left_mm = scene.target_distance_mm(tip.x_mm, tip.y_mm)
        back_rad = plane_roll_rad(tip, left_mm, scene.scenario.target.radius_mm, options.plane_roll_rad)
        if moving and (inside or outside or hopeless or rotates or back_rad is not None):
            # These decisions are not made during a motion: the needle stops and is observed again.
            self._driver.finish_insert()
            self._driver.settle(options.settling_frames)
            return None
        if approach.done(pose):
            return self._arrived(pose)
        if decision is not None and hopeless:
            beside = approach.beside(pose)
            if beside is None:
                return self._given_up(pose, decision)
            turned, length, last = beside[0], beside[1], True
        else:
            turned = pose._replace(bevel=-pose.bevel) if rotates else pose
            room = max(options.longest_mm - self._driver.goal_mm, 0.0)
            length, last = approach.length_mm(turned, room)
        self._record(pose, turned, decision, length)
        self._replan_if_needed(pose)
        if back_rad is not None:
            self._plane_rad = back_rad
        if turned.bevel != pose.bevel or back_rad is not None:
            self._driver.rotate(self._base_roll_rad(turned.bevel))
        self._carry_out(length, last=last)
        return None

    def _arrived(self, pose: Pose) -> tuple[InsertionOutcome, str]:
        """Return outcome and cause for a tip that is at its nearest to the target, which is a ball in space."""
        aside, target = self._needle.tip.z_mm, self._scene.scenario.target
        distance = math.hypot(self._scene.target_distance_mm(pose.x_mm, pose.y_mm), aside)
        outcome = InsertionOutcome.TARGET if distance <= target.radius_mm else InsertionOutcome.MISSED
        place = f"the tip is {distance:.2f} mm from the centre of the target"
        return outcome, f"{place}, {abs(aside):.2f} mm of it out of the plane"

    def _base_roll_rad(self, bevel: int) -> float:
        """Return the roll of the base (rad) for a side of the bevel, with the correction out of the plane.

        Once there was a correction, the estimated difference between the rolls of tip and base is compensated too.
        """
        if self._plane_rad is None:
            return 0.0 if bevel > 0 else math.pi
        twist = self._needle.tip.roll_rad - self._needle.roll_rad
        return (self._plane_rad if bevel > 0 else math.pi - self._plane_rad) - twist

    def _carry_out(self, length_mm: float, *, last: bool) -> None:
        driver, options = self._driver, self.options
        driver.begin_insert(driver.goal_mm + length_mm)
        if last or options.stops:
            driver.finish_insert()
            driver.settle(options.settling_frames)
        else:
            driver.finish_insert(options.velocity_mm_s * options.lead_s)

    def _remaining_mm(self) -> float:
        return self._driver.goal_mm - self._needle.path_mm

    def _pose_at_goal(self) -> Pose:
        """Return the predicted pose of the tip at the end of the present insertion.

        A pose that is at most half a cell outside the workspace is moved to the edge.
        """
        tip, bevel = self._needle.tip, self._needle.bevel
        left = self._remaining_mm()
        x, y, heading = tip.x_mm, tip.y_mm, tip.heading_rad
        if abs(left) > 1e-6:
            x, y, heading = (float(each) for each in arc_step(x, y, heading, bevel * in_plane_per_mm(tip), left))
        return Pose.wound((*self._scene.clamped(x, y), heading, bevel))

    def _given_up(self, pose: Pose, decision: Decision) -> tuple[InsertionOutcome, str]:
        promise = f"the success probability of the table is {decision.success:.2%} at {pose}"
        if Approach(self._scene, 0.0).near(pose):
            distance = self._scene.target_distance_mm(pose.x_mm, pose.y_mm)
            return (
                InsertionOutcome.MISSED,
                f"the tip is {distance:.2f} mm from the centre of the target, beside it; {promise}",
            )
        return InsertionOutcome.UNREACHABLE, promise

    def _record(self, pose: Pose, turned: Pose, decision: Decision | None, length_mm: float) -> None:
        needle, now_ns = self._needle, self._station.clock.now_ns()
        action = Action.INSERT if turned.bevel == pose.bevel else Action.ROTATE
        latency_s = (now_ns - needle.pose.stamp.received_ns) * 1e-9 if needle.pose else math.nan
        value, success = (decision.value, decision.success) if decision else (0.0, 1.0)
        step = ExecutedStep(
            self._number, now_ns, self._driver.goal_mm, pose, state_of(self.table.scenario, pose), action, value,
            success, length_mm, needle.tip, self.table.digest, latency_s,
        )  # fmt: skip
        self._number += 1
        for each in self._listeners:
            each.step(step)

    def _replan_if_needed(self, pose: Pose) -> None:
        """Request a new table if the curvature expected on the way differs too much from the planned one at `pose`."""
        if not self.options.replan or self._replanner.busy:
            return
        planned = 1 / self._scene.radius_mm(pose.x_mm, pose.y_mm)
        expected, sd = self._needle.curvature_ahead(self._scene.target_distance_mm(pose.x_mm, pose.y_mm))
        cause = curvature_mismatch(expected, sd, planned, self.options) if planned else ""
        if not cause:
            return
        try:
            scenario = rescaled(self.table.scenario, expected / planned)
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
            self.table, self._scene = table, ScenarioGeometry(table.scenario)
            radius = table.scenario.needle.curvature_radius_mm
            text = f"new table for a radius of {radius:.4g} mm, computed in {table.stats.seconds:.3f} s"
            self._emit(RunEventName.TABLE_SWAPPED, "replan", text, table.digest)

    def _on_safety(self, event: SafetyEvent) -> None:
        for each in self._listeners:
            each.safety(event)

    def _emit(self, name: RunEventName, cause: str, text: str, digest: str = "") -> None:
        event = RunEvent(self._station.clock.now_ns(), name, cause, text, self._number, digest)
        for each in self._listeners:
            each.event(event)


def _place(x_mm: float, y_mm: float) -> str:
    return f"the tip is at x {x_mm:.2f} mm, y {y_mm:.2f} mm"
