"""The guard of the stage: validates every sample, and every command directly before the command is sent.

All devices are read through `read_device`, so the guard validates every sample as soon as it arrives. The loop calls
`tick` to report that the loop is running. `insert` and `rotate` send a command only if the state is ENABLED and every
input is fresh, valid and within limits. A command with a value beyond a limit is refused, never clipped.

A person may retract the needle (`retract`) in every state, including FAULT, and with failed sensors, because pulling
the needle out is safe. No program calls `retract` on its own; the loop moves the needle outward with `insert`. A
retraction must lead outward, and its speed is limited. If the position is unknown, only a retraction to `shallowest_mm`
is accepted. A retraction is stopped by an order, by a blocked guard, and if the stage moves the wrong way or jumps.
Other causes do not stop a retraction. A retraction is in force until the stage rests, a stop or another retraction;
until then ENABLE and RESUME are refused, so the loop never moves the needle against a retraction.

A stop is repeated until the stage reports rest, or until a retraction begins. The guard is software and does not
replace an emergency stop that cuts the power of the drives.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from weakref import WeakSet

from needleplan.control.safety._causes import Cause
from needleplan.control.safety._inputs import Inputs, LoopStatus, RecordingStatus, validate
from needleplan.control.safety._limits import SafetyLimits, against_insertion, against_retraction, against_rotation
from needleplan.control.safety._motion import MotionWatch, RepeatedStop
from needleplan.control.safety._states import (
    GuardAction,
    InputReport,
    OperatingState,
    Order,
    SafetyEvent,
    SafetyEventName,
    SafetyListener,
    SafetyState,
    SafetyTransition,
    advance,
    begin_retraction,
)
from needleplan.control.safety._watchdog import Heartbeat
from needleplan.devices import Clock, Sample, SampledDevice, Source, Stage, StageSample, SystemClock
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.recording import RecorderStatus

__all__ = ["GuardedStage"]

# longest wait (s) for the lock of the guard; a thread that holds the lock longer is blocked in a command to the stage
_LOCK_TIMEOUT_S = 0.02

_RUNNING = (OperatingState.ENABLED, OperatingState.PAUSED)
_ENABLING = (Order.ENABLE, Order.RESUME, Order.CONTINUE)
_STOPPER = "stop()"  # originator of the orders of `stop`, as events name it
_GUARDED: WeakSet[Stage] = WeakSet()


class GuardedStage(Stage):
    """A stage whose `insert` and `rotate` require that all checks pass. Raises MotionRefused if `stage` has a guard.

    `listener` receives every event, in order; a stop is sent before its event. The listener must return at once and
    must not call the guard; its exception is the cause RECORDING_LOST. After each stop, the first thread that calls
    `insert` or `rotate` is the only one that may do so. Any thread may call all other methods. If another thread blocks
    the guard for more than 20 ms, a call sends a stop and raises MotionRefused; `stop`, `close` and successful reads
    do not raise.
    """

    def __init__(
        self, stage: Stage, limits: SafetyLimits | None = None, *, clock: Clock | None = None,
        listener: SafetyListener | None = None,
    ) -> None:  # fmt: skip
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
        self._recording = RecordingStatus()
        self._loop = LoopStatus(self._state.since_ns)
        self._commander: int | None = None
        self._repeated_stop = RepeatedStop(stage, self._clock)
        self._heartbeat = Heartbeat(stage, self._state.since_ns)
        self._blocked = self._stop_waits = self._listener_failed = False

    @property
    def state(self) -> SafetyState:
        """State of the guard after the last validation or order."""
        return self._state

    @property
    def limits(self) -> SafetyLimits:
        """The limits in force."""
        return self._limits

    def exchange_limits(self, limits: SafetyLimits) -> None:
        """Replace the limits; raises MotionRefused unless the state is DISABLED."""
        with self._held() as now_ns:
            if self._state.operating is not OperatingState.DISABLED:
                self._refuse("exchange the limits", (Cause.LIMITS_IN_USE,), now_ns)
            self._limits = limits

    def observe(
        self, sample: Sample, *, tip_mm: tuple[float, float] | None = None, out_of_plane_mm: float = math.nan
    ) -> SafetyState:
        """Validate a sample and all inputs, send a stop if required, and return the state.

        `tip_mm` (position in the plane) and `out_of_plane_mm` (distance from the plane) are the tip estimated from a
        pose; by default the tip becomes unknown. Both are ignored for other samples.
        """
        return self._observe(sample, (tip_mm, out_of_plane_mm))

    def _observe(self, sample: Sample, tip: tuple[tuple[float, float] | None, float] | None) -> SafetyState:
        with self._held() as now_ns:
            self._inputs = self._inputs.then(sample, tip)
            if isinstance(sample, StageSample):
                self._motion = self._motion.then(sample, self._limits)
                self._repeated_stop.observe(sample)
            return self._validate(now_ns)

    def observe_tip(self, tip_mm: tuple[float, float] | None, out_of_plane_mm: float) -> SafetyState:
        """Validate a new tip estimate: its position in the plane (None if lost) and its distance from the plane."""
        with self._held() as now_ns:
            self._inputs = self._inputs.with_tip(tip_mm, out_of_plane_mm)
            return self._validate(now_ns)

    def device_failed(self, source: Source, error: Exception) -> SafetyState:
        """Mark a device as failed until its next usable sample, validate all inputs, and return the state."""
        with self._held() as now_ns:
            self._inputs = self._inputs.with_failure(source)
            return self._validate(now_ns, str(error))

    def report(self, causes: Collection[Cause], text: str = "") -> SafetyState:
        """Replace the causes that the loop reports, such as PLAN_LOST, validate all inputs, and return the state."""
        with self._held() as now_ns:
            self._reported = frozenset(causes)
            return self._validate(now_ns, text)

    def observe_recording(self, status: RecorderStatus) -> SafetyState:
        """Validate the status of the recorder, and return the state. A lost message is a fault, a delay is a pause."""
        with self._held() as now_ns:
            self._recording = self._recording.then(status, now_ns)
            return self._validate(now_ns, status.cause)

    def tick(self) -> SafetyState:
        """Report that the loop is running, validate all inputs, and return the state. The loop calls `tick` regularly.

        Only this method sends heartbeats to the stage, at most one in 5 ms. If the loop ends or hangs, the heartbeats
        cease, and the watchdog of the stage stops the motion. If a heartbeat cannot be sent, the stage has failed.
        """
        with self._held() as now_ns:
            # Validated before the time of the last tick is replaced, so that a late tick is detected.
            state = self._validate(now_ns)
            self._loop = replace(self._loop, ticked_ns=now_ns)
            if (error := self._heartbeat.send(now_ns)) is not None:
                self._inputs = self._inputs.with_failure(Source.STAGE)
                return self._validate(now_ns, str(error))
            return self._validate(now_ns) if Cause.LOOP_LATE in state.present else state

    def heartbeat(self) -> None:
        """Call `tick`."""
        self.tick()

    def check(self) -> SafetyState:
        """Validate all inputs for the Watchdog thread, and return the state; this does not report a running loop."""
        with self._held() as now_ns:
            return self._validate(now_ns)

    def order(self, order: Order, by: str = "") -> SafetyState:
        """Validate all inputs, carry out an order of the person `by`, and return the state.

        Raises MotionRefused with all causes of the refusal.
        """
        with self._held() as now_ns:
            self._validate(now_ns)
            transition = advance(self._state, order, now_ns)
            if self._motion.retracting and order in _ENABLING:
                self._refuse(order, (Cause.NOT_POSSIBLE,), now_ns, by)
            if transition.refused:
                self._refuse(order, transition.causes, now_ns, by)
            if self._state.operating is OperatingState.DISABLED and order is Order.ENABLE:
                self._loop = replace(self._loop, enabled_ns=now_ns)
            self._obey(order, transition, now_ns, by)
            return self._state

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed. Raises MotionRefused if a check fails, or the stage's DeviceFault."""
        with self._held() as now_ns:
            self._validate(now_ns)
            limits, what = self._limits, f"insert to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._inputs.stage_known(limits, now_ns)
            self._require_none(what, against_insertion(limits, here, depth_mm, velocity_mm_s), now_ns)
            self._motion = self._motion.inserts(depth_mm, velocity_mm_s, now_ns)
            values = {"depth_mm": depth_mm, "velocity_mm_s": velocity_mm_s}
            self._send(SafetyEventName.COMMAND, self._stage.insert, values, what, now_ns)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to rotate the base to a roll. Raises MotionRefused if a check fails, or the stage's DeviceFault."""
        with self._held() as now_ns:
            self._validate(now_ns)
            what = f"rotate to {roll_rad:g} rad at {velocity_rad_s:g} rad/s"
            self._require_none(what, against_rotation(self._limits, roll_rad, velocity_rad_s), now_ns)
            self._motion = self._motion.rotates(roll_rad, velocity_rad_s, now_ns)
            values = {"roll_rad": roll_rad, "velocity_rad_s": velocity_rad_s}
            self._send(SafetyEventName.COMMAND, self._stage.rotate, values, what, now_ns)

    def retract(self, depth_mm: float, velocity_mm_s: float, by: str = "") -> None:
        """Begin to pull the needle out to a depth, by order of the person `by`, in every state; ENABLED becomes PAUSED.

        Raises MotionRefused if the goal is not outward or a value is not permitted, or the DeviceFault of the stage.
        """
        with self._held() as now_ns:
            limits, what = self._limits, f"retract to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._inputs.stage_known(limits, now_ns)
            against = against_retraction(limits, here, depth_mm, velocity_mm_s)
            if against:
                self._refuse(what, against, now_ns, by)
            self._obey_waiting(now_ns)  # a stop that was ordered before must not stop the retraction
            self._follow(begin_retraction(self._state, now_ns), now_ns, what)
            values = {"depth_mm": depth_mm, "velocity_mm_s": velocity_mm_s}
            self._send(SafetyEventName.RETRACTION, self._stage.insert, values, what, now_ns, by)
            # Only a retraction that the stage has accepted ends the repeated stop and is not stopped by other causes.
            self._motion = self._motion.retracts(depth_mm, velocity_mm_s, now_ns)
            self._repeated_stop.wanted = False

    def stop(self) -> None:
        """Stop both axes in every state, and refuse ENABLE until the order RESET.

        If another thread blocks the guard, the stage is stopped at once, and the next validation carries out the order.
        """
        try:
            self.order(Order.STOP, _STOPPER)
        except MotionRefused:
            self._stop_waits = True

    def read(self, timeout_s: float) -> StageSample | None:
        """Validate and return the next sample of the stage; return None after `timeout_s`. Raises DeviceFault."""
        sample = self.read_device(Source.STAGE, self._stage, timeout_s)
        assert sample is None or isinstance(sample, StageSample)
        return sample

    def read_device(self, source: Source, device: SampledDevice, timeout_s: float) -> Sample | None:
        """Validate and return the next sample of a device; return None after `timeout_s`.

        All samples of a run are read by this method. A pose is validated with the present tip estimate; the loop then
        calls `observe_tip` with the new one. If `device.read` raises, mark the device as failed and re-raise.
        """
        try:
            sample = device.read(timeout_s)
        except Exception as error:
            self.device_failed(source, error)
            raise
        if sample is not None:
            # If the guard is blocked, it has sent a stop; the sample itself is still valid.
            with contextlib.suppress(MotionRefused):
                self._observe(sample, None)
        return sample

    def close(self) -> None:
        """Disable the guard, stop and close the stage, and permit another guard for the stage."""
        with contextlib.suppress(MotionRefused), self._held() as now_ns:
            self._follow(advance(self._state, Order.DISABLE, now_ns), now_ns, "close")
        self._stage.close()
        _GUARDED.discard(self._stage)

    @contextlib.contextmanager
    def _held(self) -> Iterator[int]:
        """Hold the lock of the guard, and yield the time (ns).

        If another thread holds the lock for more than 20 ms, stop the stage without the lock and raise MotionRefused.
        The command of that thread may arrive after this stop, so the next validation stops again (LOOP_LATE).
        """
        if not self._lock.acquire(timeout=_LOCK_TIMEOUT_S):
            self._blocked = True
            with contextlib.suppress(DeviceFault):
                self._stage.stop()
            raise MotionRefused(
                "reach the guard: a command to the stage does not return; a stop was sent to the stage",
                (Cause.LOOP_LATE,),
            )
        try:
            yield self._clock.now_ns()
        finally:
            self._lock.release()

    def _send(
        self, name: SafetyEventName, command: Callable[..., None], values: dict[str, float], what: str, now_ns: int,
        by: str = "",
    ) -> None:  # fmt: skip
        """Send a command and emit its event; re-raise MotionRefused of the stage at once.

        On any other DeviceFault, mark the stage as failed, validate all inputs, and re-raise.
        """
        try:
            command(*values.values())
        except MotionRefused:
            raise
        except DeviceFault as error:
            self._inputs = self._inputs.with_failure(Source.STAGE)
            self._validate(now_ns, f"{what}: {error}")
            raise
        text = f"{what} by {by}" if name is SafetyEventName.RETRACTION else what
        self._emit(name, now_ns, text=text, sent_ns=self._clock.now_ns(), values=tuple(values.items()))

    def _validate(self, now_ns: int, text: str = "") -> SafetyState:
        """Validate all inputs at a time (ns), carry out the transition, repeat a stop if due, and return the state."""
        limits = self._limits
        causes = set(validate(self._inputs, limits, now_ns))
        causes.update(self._reported, self._motion.causes(limits, now_ns), self._recording.causes(limits, now_ns))
        causes.update(self._loop.causes(limits, now_ns, running=self._state.operating in _RUNNING))
        if self._blocked:
            causes.add(Cause.LOOP_LATE)
        if self._listener_failed:
            causes.add(Cause.RECORDING_LOST)
        self._loop, self._blocked, self._listener_failed = self._loop.validated(now_ns), False, False
        last = self._inputs.stage.last
        report = InputReport(frozenset(causes), last is not None and last.moving, self._motion.retracting)
        self._follow(advance(self._state, report, now_ns), now_ns, text)
        self._obey_waiting(now_ns)
        if self._repeated_stop.due(now_ns):
            self._send_stop()
        return self._state

    def _obey(self, order: Order, transition: SafetyTransition, now_ns: int, by: str) -> None:
        """Emit the event of an order that is not refused, and carry out its transition."""
        text = f"{order} by {by}" if by else str(order)
        self._emit(SafetyEventName.ORDER, now_ns, transition.causes, text, state=transition.state)
        self._follow(transition, now_ns, str(order))

    def _obey_waiting(self, now_ns: int) -> None:
        if self._stop_waits:
            self._stop_waits = False
            self._obey(Order.STOP, advance(self._state, Order.STOP, now_ns), now_ns, _STOPPER)

    def _follow(self, transition: SafetyTransition, now_ns: int, text: str) -> None:
        """Carry out a transition: first send its stop, then emit its events."""
        before, self._state = self._state, transition.state
        if transition.state is before and not transition.actions:
            return
        sent_ns = None
        if GuardAction.STOP in transition.actions:
            sent_ns = self._send_stop()
            self._motion = self._motion.stops(now_ns)
            self._commander = None
        raised, cleared = transition.state.present - before.present, before.present - transition.state.present
        if raised:
            self._emit(SafetyEventName.RAISED, now_ns, raised, text)
        if cleared:
            self._emit(SafetyEventName.CLEARED, now_ns, cleared)
        if transition.state.operating is not before.operating:
            self._emit(SafetyEventName.TRANSITION, now_ns, transition.causes, text, before=before.operating)
        if sent_ns is not None:
            self._emit(SafetyEventName.STOP, now_ns, transition.causes, text, sent_ns=sent_ns)

    def _send_stop(self) -> int:
        try:
            return self._repeated_stop.send()
        except DeviceFault:
            self._inputs = self._inputs.with_failure(Source.STAGE)
            return self._clock.now_ns()

    def _require_none(self, what: str, against: frozenset[Cause], now_ns: int) -> None:
        """Raise MotionRefused if any cause forbids the command; otherwise make this thread the commander."""
        if self._state.operating is not OperatingState.ENABLED:
            against |= {Cause.NOT_ENABLED, *self._state.present, *self._state.latched}
        elif self._commander not in (None, threading.get_ident()):
            against |= {Cause.SECOND_COMMANDER}
        if against:
            self._refuse(what, against, now_ns)
        self._commander = threading.get_ident()

    def _refuse(self, what: str, causes: Collection[Cause], now_ns: int, by: str = "") -> None:
        self._emit(SafetyEventName.REFUSAL, now_ns, frozenset(causes), f"{what} by {by}" if by else what)
        raise MotionRefused(what, sorted(causes))

    def _emit(
        self, name: SafetyEventName, now_ns: int, causes: Collection[Cause] = (), text: str = "", *,
        before: OperatingState | None = None, state: SafetyState | None = None, sent_ns: int | None = None,
        values: tuple[tuple[str, float], ...] = (),
    ) -> None:  # fmt: skip
        if self._listener is None:
            return
        operating = (state or self._state).operating
        event = SafetyEvent(name, now_ns, operating, frozenset(causes), text, before, sent_ns, values)
        try:
            self._listener(event)
        except Exception:  # a failing listener must not prevent a stop; the lost event is reported as RECORDING_LOST
            self._listener_failed = True
