"""The decisions of the guard: its lock, the validation of all inputs, and the transitions of its state."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from weakref import WeakSet

from needleplan.control.safety._causes import Cause, Owner
from needleplan.control.safety._events import SafetyEvent, SafetyEventName, SafetyListener
from needleplan.control.safety._limits import SafetyLimits
from needleplan.control.safety._monitor import RunMonitor, TipCheck
from needleplan.control.safety._states import (
    GuardAction,
    InputReport,
    MotionOrder,
    OperatingState,
    Order,
    SafetyState,
    SafetyTransition,
    advance,
)
from needleplan.control.safety._supervision import Supervision
from needleplan.control.safety._wire import GuardWire, Heartbeat, MotionCommand
from needleplan.devices import Clock, Source, Stage, SystemClock
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.stopping import Rest

__all__ = ["GuardCore"]

# Longest wait (s) for the lock of the guard, which no thread holds while it waits for a device. The wait is made twice:
# if this whole process was suspended, the first wait ends at once although the lock is about to be released.
_LOCK_TIMEOUT_S = 0.02

_RUNNING = (OperatingState.ENABLED, OperatingState.PAUSED)
_AS_ARGUMENT = 'as accepted_limits="..."'
_STOPPER = "stop()"  # originator of the orders of `stop`, as events name it
_GUARDED: WeakSet[Stage] = WeakSet()


class GuardCore:
    """State of a guard, and the decisions about it.

    Raises MotionRefused if `stage` already has a guard, and SafetyError if limits are laxer than their defaults and
    `accepted_limits`, the reason, is empty.

    Every method with the parameter `now_ns` is called with the lock held, within `_held`.
    """

    def __init__(
        self, stage: Stage, limits: SafetyLimits | None = None, *, clock: Clock | None = None,
        listener: SafetyListener | None = None, check_tip: TipCheck | None = None, needs_deadman: bool = False,
        accepted_limits: str = "", on_alarm: Callable[[Rest], object] | None = None,
    ) -> None:  # fmt: skip
        limits = SafetyLimits() if limits is None else limits
        limits.require_accepted(accepted_limits, _AS_ARGUMENT)
        if stage in _GUARDED or isinstance(stage, GuardCore):
            raise MotionRefused("guard the stage", (Cause.SECOND_COMMANDER,))
        _GUARDED.add(stage)
        self._stage = stage
        self._limits = limits
        self._clock: Clock = SystemClock() if clock is None else clock
        self._lock = threading.RLock()
        self._wire = GuardWire(stage, self._clock, listener, self._lock, self._on_stop, on_alarm)
        self._state = SafetyState(since_ns=self._clock.now_ns())
        self._monitor = RunMonitor(self._state.since_ns, check_tip, needs_deadman=needs_deadman)
        self._commander: int | None = None
        self._ticker: int | None = None
        self._supervision = Supervision(stage.supervisor)
        self._heartbeat = Heartbeat(stage, self._state.since_ns)
        self._stop_waits = False
        self._alarms: set[Rest] = set()
        """What the person was told of the present stop."""

        self._has_moved = False
        self.reason: str = ""
        """Text of the last transition: an order, or the message of the device that failed."""

        self.retractions = 0
        """Number of retractions that the stage has accepted so far."""

    @property
    def state(self) -> SafetyState:
        """State of the guard after the last validation or order."""
        return self._state

    @property
    def rest(self) -> Rest:
        """Motion state of the needle after the last stop: RESTS if it was measured at rest; UNKNOWN before any stop.

        After MOVES or UNKNOWN, treat the needle as moving.
        """
        if self._monitor.stop is None or self._state.is_stopping:
            return self._rest(self._clock.now_ns())
        return Rest.MOVES if Cause.STILL_MOVING in self._state.present else Rest.RESTS

    def _rest(self, now_ns: int) -> Rest:
        """Return the motion state of a needle after a stop; RESTS only if no stop or command is being sent."""
        rest = self._monitor.rest(now_ns)
        return Rest.BRAKES if rest is Rest.RESTS and self._wire.is_busy else rest

    @property
    def limits(self) -> SafetyLimits:
        """The limits in force."""
        return self._limits

    @contextlib.contextmanager
    def _held(self) -> Iterator[int]:
        """Hold the lock of the guard, and yield the time (ns); afterwards send the stops that were decided meanwhile.

        If another thread holds the lock for more than 40 ms, stop the stage without the lock and raise MotionRefused.
        A command of that thread may arrive after this stop, so the next validation stops again (LOOP_LATE).
        """
        if not any(self._lock.acquire(timeout=_LOCK_TIMEOUT_S) for _ in range(2)):
            self._monitor.passing.add(Cause.LOOP_LATE)
            self._wire.overtake()
            with contextlib.suppress(DeviceFault):
                self._stage.stop()
            raise MotionRefused("reach the guard: it is blocked; a stop was sent to the stage", (Cause.LOOP_LATE,))
        try:
            yield self._clock.now_ns()
        finally:
            unsent = self._wire.taken()
            self._lock.release()
            self._wire.flush(unsent)

    def _give_back(self) -> None:
        """Permit another guard for the stage."""
        _GUARDED.discard(self._stage)

    def _on_stop(self, failed: bool, took_ns: int) -> None:
        arrived_ns = self._wire.repeated_stop.arrived_ns
        if arrived_ns is not None and self._monitor.stop is not None:
            self._monitor.stop.arrived(arrived_ns * 1e-9)
        if failed:
            self._monitor.inputs = self._monitor.inputs.with_failure(Source.STAGE)
        loop = self._monitor.loop
        if self._ticker == threading.get_ident() and loop.ticked_ns is not None:
            self._monitor.ticked(loop.ticked_ns + took_ns)  # the loop could not tick while it waited for the answer

    def _command(
        self, name: SafetyEventName, values: dict[str, float], text: str, now_ns: int, by: str = ""
    ) -> MotionCommand:
        text = f"{text} by {by}" if by else text
        return self._wire.plan_command(self._event(name, now_ns, text=text, values=tuple(values.items())))

    def _send(self, command: MotionCommand, send: Callable[..., None]) -> None:
        """Send a command without the lock of the guard; re-raise MotionRefused of the stage at once.

        If a stop was decided meanwhile, another stop follows, because the command may have reached the stage after the
        first one; if the stage has refused the command, MotionRefused is raised. On any other DeviceFault, mark the
        stage as failed, validate all inputs, and re-raise.
        """
        try:
            overtaken = self._wire.send(command, send)
        except MotionRefused:
            raise
        except DeviceFault as error:
            if self._wire.stops != command.stops:
                with self._held():
                    self._wire.plan_repetition()
                raise MotionRefused(command.event.text, (Cause.STOP_ORDERED,)) from error
            with contextlib.suppress(MotionRefused):
                self._mark_failed(Source.STAGE, f"{command.event.text}: {error}")
            raise
        if overtaken:
            with self._held():
                self._wire.plan_repetition()

    def _mark_failed(self, source: Source, text: str) -> SafetyState:
        with self._held() as now_ns:
            self._monitor.inputs = self._monitor.inputs.with_failure(source)
            return self._validate(now_ns, text)

    def _validate(self, now_ns: int, text: str = "") -> SafetyState:
        """Validate all inputs at a time (ns), carry out the transition, repeat a stop if due, and return the state."""
        monitor, running = self._monitor, self._state.operating in _RUNNING
        if self._wire.events.failed:
            self._wire.events.failed = False
            monitor.passing.add(Cause.RECORDING_LOST)
        waits = self._ticker in self._wire.stopping and self._state.operating is not OperatingState.ENABLED
        is_stopping = self._state.is_stopping
        rest = self._rest(now_ns) if is_stopping else Rest.RESTS
        causes = monitor.causes(self._limits, now_ns, running=running, is_stopping=is_stopping)
        self._supervision.see(causes, self._limits)
        if waits:
            causes.discard(Cause.LOOP_LATE)  # the loop waits for the answer to a stop
        last = monitor.inputs.stage.last
        if is_stopping and rest is Rest.RESTS:
            monitor.motion = monitor.motion.rests()
        is_busy = last is not None and last.moving
        report = InputReport(frozenset(causes), is_busy, monitor.motion.retracting, rest is Rest.RESTS)
        self._follow(advance(self._state, report, now_ns), now_ns, text)
        self._obey_waiting(now_ns)
        self._insist(now_ns)
        self._supervision.post(self._limits, self._state, monitor)
        return self._state

    def _insist(self, now_ns: int) -> None:
        """Repeat a stop while the needle does not stand still, and raise the alarm if it moves in spite of the stop."""
        if not self._state.is_stopping or self._monitor.stop is None:
            self._alarms.clear()
            return
        stop, repeated = self._monitor.stop, self._wire.repeated_stop
        if repeated.due(now_ns) and (repeated.arrived_ns is None or not stop.stands):
            self._wire.plan_repetition()
        rest = self._rest(now_ns)
        is_alarm = rest is Rest.MOVES or (rest is Rest.UNKNOWN and self._has_moved)
        if is_alarm and rest not in self._alarms:
            self._alarms.add(rest)
            self._wire.plan_alarm(rest)

    def _obey(self, order: Order, transition: SafetyTransition, now_ns: int, by: str) -> None:
        """Carry out the transition of an order that is not refused; the event of the order is the first one."""
        text = f"{order} by {by}" if by else str(order)
        event = self._event(SafetyEventName.ORDER, now_ns, transition.causes, text, state=transition.state)
        self._follow(transition, now_ns, str(order), [event])

    def _obey_waiting(self, now_ns: int) -> None:
        if self._stop_waits:
            self._stop_waits = False
            self._obey(Order.STOP, advance(self._state, Order.STOP.by(Owner.PERSON), now_ns), now_ns, _STOPPER)

    def _follow(
        self, transition: SafetyTransition, now_ns: int, text: str, events: Collection[SafetyEvent] = ()
    ) -> None:
        """Carry out a transition: its stop is sent, and then its events are emitted, when the lock is released."""
        before, self._state = self._state, transition.state
        self._supervision.post(self._limits, self._state, self._monitor)
        if transition.state is before and not transition.actions and not events:
            return
        if transition.state.is_zero_lost and not before.is_zero_lost:
            self._wire.plan_unhome()
        listed = list(events)
        raised, cleared = transition.state.present - before.present, before.present - transition.state.present
        if raised:
            listed.append(self._event(SafetyEventName.RAISED, now_ns, raised, text))
        if cleared:
            listed.append(self._event(SafetyEventName.CLEARED, now_ns, cleared))
        if transition.state.operating is not before.operating:
            self.reason = text
            event = self._event(SafetyEventName.TRANSITION, now_ns, transition.causes, text)
            listed.append(replace(event, before=before.operating))
        if GuardAction.STOP not in transition.actions:
            self._wire.plan_events(*listed)
            return
        self._monitor.stops(self._limits, now_ns, anew=not before.is_stopping)
        self._commander = None
        stop = self._event(SafetyEventName.STOP, now_ns, transition.causes, text)
        self._wire.plan_stop(listed, stop)

    def _require_none(self, request: str, against: frozenset[Cause], now_ns: int) -> None:
        """Raise MotionRefused if any cause forbids the command; otherwise make this thread the commander."""
        transition = advance(self._state, MotionOrder.MOVE.by(Owner.LOOP), now_ns)
        if transition.refused:
            against |= transition.causes
        elif self._commander not in (None, threading.get_ident()):
            against |= {Cause.SECOND_COMMANDER}
        if against:
            self._refuse(request, against, now_ns)
        self._state, self._commander = transition.state, threading.get_ident()
        self._monitor.stop, self._has_moved = None, True

    def _refuse(self, request: str, causes: Collection[Cause], now_ns: int, by: str = "") -> None:
        event = self._event(SafetyEventName.REFUSAL, now_ns, causes, f"{request} by {by}" if by else request)
        self._wire.plan_events(event)
        raise MotionRefused(request, sorted(causes))

    def _event(
        self, name: SafetyEventName, now_ns: int, causes: Collection[Cause] = (), text: str = "", *,
        state: SafetyState | None = None, values: tuple[tuple[str, float], ...] = (),
    ) -> SafetyEvent:  # fmt: skip
        return SafetyEvent(name, now_ns, (state or self._state).operating, frozenset(causes), text, values=values)
