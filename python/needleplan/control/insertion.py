"""The intraoperative loop: from the estimated tip to the next action of the table, step by step, until it ends.

A decision is made at the end of every step; where the needle does not have to stop, a moment before it, for the place
where the step will end. To rotate it stops, looks again, and decides from where it stands. The last step ends where the
arc is closest to the centre of the target.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from contextlib import ExitStack

from needleplan.control.approach import NEARLY_MM, Approach
from needleplan.control.entry import measured_entry, require_expected
from needleplan.control.listening import Event, EventName, Listener, Step
from needleplan.control.needle import Needle, Stopped
from needleplan.control.options import Options
from needleplan.control.replanning import Replanner, ThreadReplanner, curvature_left, rescaled
from needleplan.control.report import Ending, Report, Trace
from needleplan.control.safety import GuardedStage, SafetyEvent, SafetyLimits
from needleplan.control.scene import Scene
from needleplan.devices import Closing, Station, VirtualClock, no_long_collections, short_turns
from needleplan.errors import DeviceFault, InputError, NeedleplanError
from needleplan.estimation.registration import Registration
from needleplan.estimation.tip import TipFilter, TipSettings
from needleplan.models import arc_step
from needleplan.planning import Action, Decision, Path, PolicyTable, Pose

__all__ = ["Insertion"]

_FIRST_FRAMES = 10


class Insertion(Closing):
    """One insertion with a policy table; `run` it once.

    The sensors stay open; closing it closes the stage. `registration` takes the tracker to the plan; without one its
    frame is that of the plan. `limits` are those of the guard before the stage, which also has what a person needs:
    retraction, above all.
    `replanner` makes new tables. Listeners hear of everything.
    """

    def __init__(
        self, table: PolicyTable, station: Station, options: Options | None = None, *,
        registration: Registration | None = None,
        tip_settings: TipSettings | None = None,
        limits: SafetyLimits | None = None,
        replanner: Replanner | None = None,
        listeners: Sequence[Listener] = (),
    ) -> None:  # fmt: skip
        self.table = table
        self.options = options or Options()
        self._station = station
        self._scene = Scene(table.scenario)
        self._trace = Trace(self.options.force_axis)
        self._listeners = (self._trace, *listeners)
        self.guard = GuardedStage(station.stage, limits, clock=station.clock, listener=self._heard)
        self._needle = Needle(self.guard, station.clock, self.options, self._listeners)
        self._needle.on_pause = self._paused
        self.registration = registration or Registration()
        self._tip_settings = tip_settings
        self._replanner = replanner or ThreadReplanner(wait=isinstance(station.clock, VirtualClock))
        self._first_table = table
        self._planned: Path | None = None
        self._number = 0
        self._thread = 0
        # What takes its time the first time is done before anything moves.
        _ = table.lattice, table.digest, self._scene.touches(0.0, 0.0)

    def stop(self, cause: str) -> None:
        """Let the run end at once with the needle where it is; from any thread or signal, and for good."""
        self._needle.stop_cause = self._needle.stop_cause or cause or "stopped"
        if self._thread and threading.get_ident() != self._thread:  # a signal interrupts the thread of the loop itself
            self.guard.stop()

    def close(self) -> None:
        """Stop, and close the stage; closing twice is harmless."""
        self.guard.close()

    def run(self) -> Report:
        """Insert. Whatever happens, the needle stands afterwards, and the report says why."""
        ending, cause = Ending.FAULT, "the program ended"
        self._thread = threading.get_ident()
        with ExitStack() as closing:
            closing.callback(self._replanner.close)
            if not isinstance(self._station.clock, VirtualClock):
                closing.enter_context(no_long_collections())
                closing.enter_context(short_turns())
            try:
                ending, cause = self._run(closing)
            except Stopped as stopped:
                ending, cause = Ending.STOPPED, str(stopped)
            except KeyboardInterrupt:
                ending, cause = Ending.STOPPED, "interrupted by the operator"
            except (DeviceFault, InputError) as fault:
                ending, cause = (Ending.FAULT if self._needle.moved else Ending.REFUSED), str(fault)
            finally:
                self._halt(ending, cause)
        return self._trace.report(ending, cause, self._first_table, self._planned, self._needle.path_mm)

    def _halt(self, ending: Ending, cause: str) -> None:
        names = {Ending.FAULT: EventName.FAULT, Ending.REFUSED: EventName.FAULT, Ending.STOPPED: EventName.STOP}
        self._needle.halt(latch=ending in names)
        if ending in names:
            self._tell(names[ending], str(ending), cause)
        self._tell(EventName.END, str(ending), cause)

    def _run(self, closing: ExitStack) -> tuple[Ending, str]:
        self._tell(EventName.BEGIN, "operator", f"table {self.table.digest}", self.table.digest)
        self._station.force_sensor.bias()
        self._tell(EventName.BIAS, "begin", "the force at rest is zero")
        feed = self._station.feed(self.guard)
        closing.callback(feed.close)
        self._needle.hear(feed)
        ended = self._begin()
        while ended is None:
            ended = self._judged() or self._step()
        return ended

    def _begin(self) -> tuple[Ending, str] | None:
        """Find out where the tip is, and turn the bevel to the better side."""
        needle, options = self._needle, self.options
        needle.listen_until(lambda: needle.stage is not None, options.silence_s, "stage: the first sample")
        entry = measured_entry(needle, self.registration, _FIRST_FRAMES, self.guard.limits.pose_age_s)
        require_expected(entry, options)
        needle.filter = TipFilter.for_scenario(self._scene.scenario, self.registration, entry, self._tip_settings)
        needle.settle(_FIRST_FRAMES)
        x, y = self._scene.clamped(*entry[:2])
        start = self.table.start((x, y, entry[2]))
        self._planned = self.table.path(start)
        decision = self.table.lookup(*start)
        if decision.success < self.options.least_success:
            return self._given_up(start, decision)
        needle.enable()
        if needle.path_mm < -NEARLY_MM:
            needle.begin_insert(0.0)
            needle.finish_insert()
            needle.settle(self.options.settling_frames)
        if start.bevel != needle.bevel:
            needle.rotate(0.0 if start.bevel > 0 else math.pi)
        needle.goal_mm = needle.path_mm
        return None

    def _judged(self) -> tuple[Ending, str] | None:
        """Return how it has ended, by where the tip is now."""
        tip, scene, options = self._needle.tip, self._scene, self.options
        place = f"the tip is at x {tip.x_mm:.2f} mm, y {tip.y_mm:.2f} mm"
        if scene.outside(tip.x_mm, tip.y_mm):
            return Ending.OUTSIDE, f"{place}, outside of the workspace"
        touched = scene.touches(tip.x_mm, tip.y_mm)
        if touched:
            return Ending.COLLISION, f"{place}, in {touched}"
        if self._needle.path_mm >= options.longest_mm - NEARLY_MM:
            return Ending.TOO_LONG, f"the path has the length that is allowed, {options.longest_mm:g} mm"
        return None

    def _step(self) -> tuple[Ending, str] | None:
        """Decide, and do it; return how it has ended if it has."""
        self._take_table()
        pose, scene, options = self._pose_at_goal(), self._scene, self.options
        approach = Approach(scene, self._needle.tip.curvature_per_mm)
        ahead = self._remaining_mm() > NEARLY_MM
        inside, outside = approach.inside(pose), scene.outside(pose.x_mm, pose.y_mm)
        asked = pose if outside else Pose(*scene.decided_at(*pose[:2]), pose.heading_rad, pose.bevel)
        decision = None if inside or outside else self.table.lookup(*asked)
        hopeless = decision is not None and decision.success < options.least_success
        rotates = decision is not None and decision.action is Action.ROTATE
        if ahead and (inside or outside or hopeless or rotates):
            # That is not decided in passing: the needle stops, and looks again.
            self._needle.finish_insert()
            self._needle.settle(options.settling_frames)
            return None
        if approach.done(pose):
            distance = scene.target_distance_mm(pose.x_mm, pose.y_mm)
            return Ending.TARGET, f"the tip is {distance:.2f} mm from the centre of the target"
        if decision is not None and hopeless:
            beside = approach.beside(pose)
            if beside is None:
                return self._given_up(pose, decision)
            turned, length, last = beside[0], beside[1], True
        else:
            turned = pose._replace(bevel=-pose.bevel) if rotates else pose
            room = max(options.longest_mm - self._needle.goal_mm, 0.0)
            length, last = approach.length_mm(turned, room)
        self._record(pose, asked, turned, decision, length)
        self._consider(pose)
        self._carry_out(pose, turned, length, last=last)
        return None

    def _carry_out(self, pose: Pose, turned: Pose, length_mm: float, *, last: bool) -> None:
        needle, options = self._needle, self.options
        if turned.bevel != pose.bevel:
            needle.rotate(0.0 if turned.bevel > 0 else math.pi)
        needle.begin_insert(needle.goal_mm + length_mm)
        if last or options.stops:
            needle.finish_insert()
            needle.settle(options.settling_frames)
        else:
            needle.finish_insert(options.velocity_mm_s * options.lead_s)

    def _remaining_mm(self) -> float:
        return self._needle.goal_mm - self._needle.path_mm

    def _pose_at_goal(self) -> Pose:
        """Return where the tip will be when the present insertion has come to its end."""
        tip, bevel = self._needle.tip, self._needle.bevel
        left = self._remaining_mm()
        x, y, heading = tip.x_mm, tip.y_mm, tip.heading_rad
        if abs(left) > 1e-6:
            x, y, heading = (float(each) for each in arc_step(x, y, heading, bevel * tip.curvature_per_mm, left))
        return Pose.wound((*self._scene.clamped(x, y), heading, bevel))

    def _given_up(self, pose: Pose, decision: Decision) -> tuple[Ending, str]:
        promise = f"the table promises {decision.success:.2%} from {pose}"
        if Approach(self._scene, 0.0).near(pose):
            distance = self._scene.target_distance_mm(pose.x_mm, pose.y_mm)
            return Ending.MISSED, f"the tip is {distance:.2f} mm from the centre of the target, beside it; {promise}"
        return Ending.UNREACHABLE, promise

    def _record(self, pose: Pose, asked: Pose, turned: Pose, decision: Decision | None, length_mm: float) -> None:
        needle, now_ns = self._needle, self._station.clock.now_ns()
        action = Action.INSERT if turned.bevel == pose.bevel else Action.ROTATE
        latency_s = (now_ns - needle.pose.stamp.received_ns) * 1e-9 if needle.pose else math.nan
        value, success = (decision.value, decision.success) if decision else (0.0, 1.0)
        step = Step(
            self._number, now_ns, needle.goal_mm, pose, self._state(asked), action, value, success, length_mm,
            self._needle.tip, self.table.digest, latency_s,
        )  # fmt: skip
        self._number += 1
        for listener in self._listeners:
            listener.step(step)

    def _state(self, pose: Pose) -> tuple[int, int, int, int]:
        """Return the indices of the state nearest to a pose."""
        scenario = self.table.scenario
        (dx, dy), headings = scenario.grid.spacing_mm, scenario.motion.headings
        turn = round(pose.heading_rad / (2 * math.pi / headings)) % headings
        return round(pose.x_mm / dx), round(pose.y_mm / dy), turn, (pose.bevel + 1) // 2

    def _consider(self, pose: Pose) -> None:
        """Plan again if the needle does not bend as planned."""
        if not self.options.replan or self._replanner.busy:
            return
        tip = self._needle.tip
        planned = 1 / self._scene.radius_mm(pose.x_mm, pose.y_mm)
        cause = curvature_left(tip, planned, self.options)
        if not cause:
            return
        try:
            scenario = rescaled(self.table.scenario, tip.curvature_per_mm / planned)
        except InputError as error:
            self._tell(EventName.REPLAN_REFUSED, cause, str(error))
            return
        self._tell(EventName.REPLAN_ASKED, cause, "planning again with the estimated curvature")
        self._replanner.ask(scenario)

    def _take_table(self) -> None:
        """Go on with the new table if there is one."""
        try:
            table = self._replanner.take(self._number)
        except NeedleplanError as error:
            self._tell(EventName.REPLAN_REFUSED, "planner", str(error))
            return
        if table is not None:
            self.table, self._scene = table, Scene(table.scenario)
            radius = table.scenario.needle.curvature_radius_mm
            text = f"a table for a radius of {radius:.4g} mm, made in {table.stats.seconds:.3f} s"
            self._tell(EventName.TABLE_SWAPPED, "replan", text, table.digest)

    def _paused(self, causes: str, text: str) -> None:
        self._tell(EventName.PAUSED if causes else EventName.RESUMED, causes, text)

    def _heard(self, event: SafetyEvent) -> None:
        for listener in self._listeners:
            listener.safety(event)

    def _tell(self, name: EventName, cause: str, text: str, digest: str = "") -> None:
        event = Event(self._station.clock.now_ns(), name, cause, text, self._number, digest)
        for listener in self._listeners:
            listener.event(event)
