"""A stage that moves only where it is safe to: the last thing between the loop and the wire.

What the devices say is given to `observe`, and the loop says with `tick` that it is alive. A motion command is carried
out where the state is ENABLED and every input is fresh, valid and in its limits; it is refused, never clipped, where a
value of its own is beyond a limit. Nothing happens between this check and the stage.

Retraction by a person, `retract`, is not refused in any state, FAULT included, whatever the sensors say: pulling the
needle out is the way to safety, and a sensor that has died must not keep it in. It is a person's decision, so no
program may call it by itself; the loop takes the needle back by `insert`, under the same rules as inward. What bounds
it is its speed, and that it must lead outward from where the stage is; where that is not known, only the whole way out
to `shallowest_mm` is accepted. A cause that comes meanwhile does not stop it, except that the stage goes the wrong way;
a person's stop does.

A stop is repeated until the stage reports that it stands still. All of this is for software; it is no substitute for
an emergency stop that cuts the power of the drives.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Collection, Iterator
from dataclasses import replace
from weakref import WeakSet

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.commands import against_insertion, against_retraction, against_rotation
from needleplan.control.safety.events import EventName, Listener, SafetyEvent
from needleplan.control.safety.inputs import Inputs, judge
from needleplan.control.safety.limits import SafetyLimits
from needleplan.control.safety.machine import Action, OperatingState, Order, Report, SafetyState, Step, advance
from needleplan.control.safety.motion import MotionWatch
from needleplan.control.safety.record import RecordWatch
from needleplan.control.safety.stopping import Heartbeat, Stopping
from needleplan.devices import Clock, ForceSample, PoseSample, Source, Stage, StageSample, SystemClock
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.recording import RecorderStatus

__all__ = ["GuardedStage"]

_NANO = 1e-9
_PATIENCE_S = 0.02
"""Nobody holds the guard for so long who is not hanging in a command to the stage."""

_RUNNING = (OperatingState.ENABLED, OperatingState.PAUSED)
_ENDS_RETRACTION = frozenset({Cause.WRONG_WAY, Cause.STAGE_JUMPED})
_GUARDED: WeakSet[Stage] = WeakSet()


class GuardedStage(Stage):
    """`stage` behind the limits. Raises MotionRefused where another guard has the stage already.

    `listener` is told every event, in order, after the stop that belongs to it is on the wire; it must return at once,
    as `Channel.put` of a recording does, and not call the guard. One thread commands: the first to do so once the stage
    is enabled. Everything else may be called by any thread.
    """

    def __init__(
        self,
        stage: Stage,
        limits: SafetyLimits | None = None,
        *,
        clock: Clock | None = None,
        listener: Listener | None = None,
    ) -> None:
        if stage in _GUARDED or isinstance(stage, GuardedStage):
            raise MotionRefused("guard the stage", (Cause.SECOND_COMMANDER,))
        _GUARDED.add(stage)
        self._stage = stage
        self._limits = SafetyLimits() if limits is None else limits
        self._clock: Clock = SystemClock() if clock is None else clock
        self._listener = listener
        self._lock = threading.RLock()
        self._state = SafetyState(since_ns=self._clock.now_ns())
        self._inputs, self._motion = Inputs(), MotionWatch()
        self._reported: frozenset[Cause] = frozenset()
        self._record = RecordWatch()
        self._ticked_ns: int | None = None
        self._latest_ns = self._state.since_ns
        self._enabled_ns = 0
        self._commander: int | None = None
        self._stopping = Stopping(stage, self._clock)
        self._heartbeat = Heartbeat(stage, self._state.since_ns)
        self._retracting = self._overtaken = self._deaf = False

    @property
    def state(self) -> SafetyState:
        """The state as of the last look."""
        return self._state

    @property
    def limits(self) -> SafetyLimits:
        """The limits in force."""
        return self._limits

    def exchange_limits(self, limits: SafetyLimits) -> None:
        """Take other limits. Raises MotionRefused unless DISABLED: they do not change under a moving needle."""
        with self._held() as now_ns:
            if self._state.operating is not OperatingState.DISABLED:
                self._refuse("exchange the limits", (Cause.LIMITS_IN_USE,), now_ns)
            self._limits = limits

    def observe(
        self,
        sample: ForceSample | PoseSample | StageSample,
        *,
        tip_mm: tuple[float, float] | None = None,
        out_of_plane_mm: float = math.nan,
    ) -> SafetyState:
        """Take a sample; with a pose the tip that the loop has made of it, and its distance from the plane.

        A stop that it calls for is on the wire when this returns.
        """
        with self._held() as now_ns:
            match sample:
                case ForceSample():
                    self._inputs = self._inputs.with_force(sample)
                case PoseSample():
                    self._inputs = self._inputs.with_pose(sample, tip_mm, out_of_plane_mm)
                case StageSample():
                    self._inputs = self._inputs.with_stage(sample)
                    self._motion = self._motion.sees(sample, self._limits)
                    self._settle(sample, now_ns)
            return self._look(now_ns)

    def device_failed(self, source: Source, error: Exception) -> SafetyState:
        """Take it that a device has given up, until its next usable sample."""
        with self._held() as now_ns:
            self._fail(source)
            return self._look(now_ns, str(error))

    def report(self, causes: Collection[Cause], text: str = "") -> SafetyState:
        """Say what is wrong from now on as the loop sees it, such as PLAN_LOST; nothing ends it."""
        with self._held() as now_ns:
            self._reported = frozenset(causes)
            return self._look(now_ns, text)

    def observe_recording(self, status: RecorderStatus) -> SafetyState:
        """Take the status of the recorder; what is not in the recording has not happened, so losing it is a fault."""
        with self._held() as now_ns:
            self._record = self._record.sees(status, now_ns)
            return self._look(now_ns, status.cause)

    def tick(self) -> SafetyState:
        """Report that the loop is running, and validate everything; the loop calls it once per iteration.

        This is the only place from which the stage gets its heartbeat: a loop that dies or hangs ends the heartbeat,
        and the watchdog of the stage stops the motion.
        """
        with self._held() as now_ns:
            # A turn that came too late is judged before it is forgotten.
            state = self._look(now_ns)
            self._ticked_ns = now_ns
            if (error := self._heartbeat.send(now_ns)) is not None:
                self._fail(Source.STAGE)
                return self._look(now_ns, str(error))
            return self._look(now_ns) if Cause.LOOP_LATE in state.present else state

    def heartbeat(self) -> None:
        """Report that the loop is running; the same as `tick`."""
        self.tick()

    def check(self) -> SafetyState:
        """Look at everything for somebody who is not the loop: the watchdog."""
        with self._held() as now_ns:
            return self._look(now_ns)

    def order(self, order: Order, by: str = "") -> SafetyState:
        """Carry out an order of the person `by`. Raises MotionRefused with every cause against it."""
        with self._held() as now_ns:
            self._look(now_ns)
            step = advance(self._state, order, now_ns)
            if step.refused:
                self._refuse(order, step.causes, now_ns, by)
            if Action.STOP in step.actions:
                self._retracting = False
            if self._state.operating is OperatingState.DISABLED and order is Order.ENABLE:
                self._enabled_ns = now_ns
            self._tell(EventName.ORDER, now_ns, step.causes, f"{order} by {by}" if by else order, state=step.state)
            self._follow(step, now_ns, str(order))
            return self._state

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed. Raises MotionRefused, and DeviceFault where the stage does."""
        with self._held() as now_ns:
            self._look(now_ns)
            limits, what = self._limits, f"insert to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._inputs.stage_known(limits, now_ns)
            self._require_none(what, against_insertion(limits, here, depth_mm, velocity_mm_s), now_ns)
            self._motion = self._motion.inserts(depth_mm, velocity_mm_s, now_ns)
            with self._to_stage(what, now_ns):
                self._stage.insert(depth_mm, velocity_mm_s)
            values = (("depth_mm", depth_mm), ("velocity_mm_s", velocity_mm_s))
            self._tell(EventName.COMMAND, now_ns, text=what, sent_ns=self._clock.now_ns(), values=values)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to turn the base to a roll. Raises MotionRefused, and DeviceFault where the stage does."""
        with self._held() as now_ns:
            self._look(now_ns)
            what = f"rotate to {roll_rad:g} rad at {velocity_rad_s:g} rad/s"
            self._require_none(what, against_rotation(self._limits, roll_rad, velocity_rad_s), now_ns)
            self._motion = self._motion.rotates(roll_rad, velocity_rad_s, now_ns)
            with self._to_stage(what, now_ns):
                self._stage.rotate(roll_rad, velocity_rad_s)
            values = (("roll_rad", roll_rad), ("velocity_rad_s", velocity_rad_s))
            self._tell(EventName.COMMAND, now_ns, text=what, sent_ns=self._clock.now_ns(), values=values)

    def retract(self, depth_mm: float, velocity_mm_s: float, by: str = "") -> None:
        """Pull the needle out to a depth, by order of the person `by`; in every state. From ENABLED it pauses first.

        Raises MotionRefused where that does not lead outward, or too fast; DeviceFault where the stage does.
        """
        with self._held() as now_ns:
            limits, what = self._limits, f"retract to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._inputs.stage_known(limits, now_ns)
            against = against_retraction(limits, here, depth_mm, velocity_mm_s)
            if against:
                self._refuse(what, against, now_ns, by)
            if self._state.operating is OperatingState.ENABLED:
                self._follow(advance(self._state, Order.PAUSE, now_ns), now_ns, what)
            if self._motion.last is not None:
                self._motion = self._motion.inserts(depth_mm, velocity_mm_s, now_ns)
            self._retracting, self._stopping.wanted = True, False
            with self._to_stage(what, now_ns):
                self._stage.insert(depth_mm, velocity_mm_s)
            values = (("depth_mm", depth_mm), ("velocity_mm_s", velocity_mm_s))
            self._tell(
                EventName.RETRACTION, now_ns, text=f"{what} by {by}", sent_ns=self._clock.now_ns(), values=values
            )

    def stop(self) -> None:
        """Stop now, and stay stopped until a person resets and enables; always allowed."""
        with contextlib.suppress(MotionRefused):
            self.order(Order.STOP, "stop()")

    def read(self, timeout_s: float) -> StageSample | None:
        """Return the next sample of the stage, which is observed at once. Raises DeviceFault."""
        try:
            sample = self._stage.read(timeout_s)
        except DeviceFault as error:
            self.device_failed(Source.STAGE, error)
            raise
        if sample is not None:
            # Where the guard cannot be reached it has sent a stop; the sample is none the worse for it.
            with contextlib.suppress(MotionRefused):
                self.observe(sample)
        return sample

    def close(self) -> None:
        """Stop, and close the stage."""
        with contextlib.suppress(MotionRefused), self._held() as now_ns:
            self._follow(advance(self._state, Order.DISABLE, now_ns), now_ns, "close")
        self._stage.close()
        _GUARDED.discard(self._stage)

    @contextlib.contextmanager
    def _held(self) -> Iterator[int]:
        """Hold the guard; where somebody else has held it for too long, stop the stage over his head.

        He may be hanging in a command to the stage, and his command may yet go out: the stop that follows as soon as he
        lets go is the one that counts.
        """
        if not self._lock.acquire(timeout=_PATIENCE_S):
            self._overtaken = True
            with contextlib.suppress(DeviceFault):
                self._stage.stop()
            raise MotionRefused("reach the guard: a command to the stage hangs; it was sent a stop", (Cause.LOOP_LATE,))
        try:
            yield self._clock.now_ns()
        finally:
            self._lock.release()

    @contextlib.contextmanager
    def _to_stage(self, what: str, now_ns: int) -> Iterator[None]:
        try:
            yield
        except MotionRefused:
            raise
        except DeviceFault as error:
            self._fail(Source.STAGE)
            self._look(now_ns, f"{what}: {error}")
            raise

    def _look(self, now_ns: int, text: str = "") -> SafetyState:
        """Judge everything at a moment, and follow the state."""
        limits = self._limits
        causes = set(judge(self._inputs, limits, now_ns))
        causes.update(self._reported, self._motion.judge(limits, now_ns), self._record.judge(limits, now_ns))
        late = self._ticked_ns is None or (now_ns - self._ticked_ns) * _NANO > limits.loop_age_s
        if late or self._overtaken:
            causes.add(Cause.LOOP_LATE)
        if now_ns < self._latest_ns:
            causes.add(Cause.CLOCK_MISMATCH)
        running_s = (now_ns - self._enabled_ns) * _NANO
        if running_s > limits.run_s and self._state.operating in _RUNNING:
            causes.add(Cause.TIME_EXCEEDED)
        if self._deaf:
            causes.add(Cause.RECORDING_LOST)
        self._latest_ns, self._overtaken, self._deaf = max(now_ns, self._latest_ns), False, False
        last = self._inputs.stage.last
        self._follow(
            advance(self._state, Report(frozenset(causes), last is not None and last.moving), now_ns), now_ns, text
        )
        if self._stopping.due(now_ns):
            self._send_stop()
        return self._state

    def _follow(self, step: Step, now_ns: int, text: str) -> None:
        """Do what a step asks for, stop first, then tell what has happened."""
        before, self._state = self._state, step.state
        if step.state is before and not step.actions:
            return
        sent_ns = None
        if Action.STOP in step.actions and (not self._retracting or step.causes & _ENDS_RETRACTION):
            self._retracting = False
            sent_ns = self._send_stop()
            self._motion = self._motion.stops(now_ns)
            self._commander = None
        raised, cleared = step.state.present - before.present, before.present - step.state.present
        if raised:
            self._tell(EventName.RAISED, now_ns, raised, text)
        if cleared:
            self._tell(EventName.CLEARED, now_ns, cleared)
        if step.state.operating is not before.operating:
            self._tell(EventName.TRANSITION, now_ns, step.causes, text, before=before.operating)
        if sent_ns is not None:
            self._tell(EventName.STOP, now_ns, step.causes, text, sent_ns=sent_ns)

    def _send_stop(self) -> int:
        try:
            return self._stopping.send()
        except DeviceFault:
            self._fail(Source.STAGE)
            return self._clock.now_ns()

    def _settle(self, sample: StageSample, now_ns: int) -> None:
        """See whether a stop or a retraction has come to its end."""
        self._stopping.sees(sample)
        goal = self._motion.depth
        if self._retracting and goal is not None and not sample.moving:
            waited_s = (now_ns - goal.began_ns) * _NANO
            if abs(sample.depth_mm - goal.end) <= self._limits.following_mm or waited_s > self._limits.motion_s:
                self._retracting = False
                self._motion = self._motion.stops(now_ns)

    def _fail(self, source: Source) -> None:
        inputs = self._inputs
        match source:
            case Source.FORCE:
                self._inputs = replace(inputs, force=replace(inputs.force, failed=True))
            case Source.POSE:
                self._inputs = replace(inputs, pose=replace(inputs.pose, failed=True))
            case Source.STAGE:
                self._inputs = replace(inputs, stage=replace(inputs.stage, failed=True))

    def _require_none(self, what: str, against: frozenset[Cause], now_ns: int) -> None:
        """Let a command of the loop through where nothing is against it. Raises MotionRefused."""
        if self._state.operating is not OperatingState.ENABLED:
            against |= {Cause.NOT_ENABLED, *self._state.present, *self._state.latched}
        elif self._commander not in (None, threading.get_ident()):
            against |= {Cause.SECOND_COMMANDER}
        if against:
            self._refuse(what, against, now_ns)
        self._commander = threading.get_ident()

    def _refuse(self, what: str, causes: Collection[Cause], now_ns: int, by: str = "") -> None:
        self._tell(EventName.REFUSAL, now_ns, frozenset(causes), f"{what} by {by}" if by else what)
        raise MotionRefused(what, sorted(causes))

    def _tell(
        self,
        name: EventName,
        now_ns: int,
        causes: Collection[Cause] = (),
        text: str = "",
        *,
        before: OperatingState | None = None,
        state: SafetyState | None = None,
        sent_ns: int | None = None,
        values: tuple[tuple[str, float], ...] = (),
    ) -> None:
        if self._listener is None:
            return
        operating = (state or self._state).operating
        event = SafetyEvent(name, now_ns, operating, frozenset(causes), text, before, sent_ns, values)
        try:
            self._listener(event)
        except Exception:  # whoever listens must not keep a stop from being sent; what he did not hear is lost
            self._deaf = True
