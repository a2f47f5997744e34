"""What the guard sends to its stage and its listener: repeated stops, heartbeats, and the events in their order.

The guard decides with its lock held, and sends after it has released the lock, so that a stop that the stage does not
answer blocks no other thread. Events are emitted in the order of the decisions; the event of a stop or of a command,
and all later events, are emitted after the stop or the command has been sent.
"""

from __future__ import annotations

import contextlib
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from needleplan import _ppvi
from needleplan.control.safety._causes import Cause
from needleplan.control.safety._events import SafetyEvent, SafetyListener
from needleplan.devices import Clock, Stage
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.stopping import Rest

__all__ = ["EventSlot", "GuardWire", "Heartbeat", "MotionCommand", "OrderedEvents"]


@dataclass
class EventSlot:
    """Events of one decision; they are emitted when `is_ready` is set and all earlier slots have been emitted."""

    events: list[SafetyEvent] = field(default_factory=list)
    is_ready: bool = False


class OrderedEvents:
    """Emits slots of events to a listener in the order of their reservation. Any thread may call `emit`."""

    def __init__(self, listener: SafetyListener | None) -> None:
        self._listener = listener
        self._slots: deque[EventSlot] = deque()
        self._emitting = threading.Lock()
        self.failed = False
        """Whether the listener has raised an exception, so that an event is lost."""

    def reserve(self, events: list[SafetyEvent], *, is_ready: bool) -> EventSlot:
        """Append a slot and return it. The caller holds the lock of the guard."""
        slot = EventSlot(events, is_ready)
        if self._listener is not None:
            self._slots.append(slot)
        return slot

    def emit(self) -> None:
        """Emit all slots that are ready; if another thread is emitting, that thread emits them."""
        while self._is_next_ready() and self._emitting.acquire(blocking=False):
            try:
                while self._is_next_ready():
                    for event in self._slots.popleft().events:
                        self._pass_on(event)
            finally:
                self._emitting.release()

    def _is_next_ready(self) -> bool:
        try:
            return self._slots[0].is_ready
        except IndexError:
            return False

    def _pass_on(self, event: SafetyEvent) -> None:
        assert self._listener is not None
        try:
            self._listener(event)
        except Exception:  # a failing listener must not prevent a stop; the lost event is reported as RECORDING_LOST
            self.failed = True


class Heartbeat:
    """Sends the heartbeat to one stage, at most every 4.5 ms. No other code of the package sends it during a run."""

    def __init__(self, stage: Stage, now_ns: int) -> None:
        self._stage = stage
        self._timer = _ppvi.HeartbeatTimer(now_ns)

    def send(self, now_ns: int) -> DeviceFault | None:
        """Send a heartbeat if the last one is at least 4.5 ms old. Return the DeviceFault of the stage, or None."""
        if not self._timer.take(now_ns):
            return None
        try:
            self._stage.heartbeat()
        except DeviceFault as error:
            return error
        return None


@dataclass(frozen=True)
class MotionCommand:
    """A motion command before it is sent; `stops` is the number of stops that were decided before the command."""

    values: dict[str, float]
    event: SafetyEvent
    slot: EventSlot
    stops: int


class GuardWire:
    """Sends stops and commands to `stage`, and events to `listener`.

    The guard calls the methods `plan_...` with its `lock` held, and `flush` and `send` without it. For each stop that
    was sent, `on_stop(failed, took_ns)` is called with the lock held; `took_ns` is the duration of sending. `on_alarm`
    gets what is known of a needle that does not come to rest, without the lock.
    """

    def __init__(
        self, stage: Stage, clock: Clock, listener: SafetyListener | None, lock: threading.RLock,
        on_stop: Callable[[bool, int], None], on_alarm: Callable[[Rest], object] | None = None,
    ) -> None:  # fmt: skip
        self._on_alarm = on_alarm
        self._stage, self._clock, self._lock, self._on_stop = stage, clock, lock, on_stop
        self.events: OrderedEvents = OrderedEvents(listener)
        self.repeated_stop: _ppvi.RepeatedStop = _ppvi.RepeatedStop()
        """Times at which a stop is repeated, and the number of stops on their way."""

        self.stops = 0
        """Number of stops that were decided so far; repetitions do not count."""

        self.stopping: set[int] = set()
        """Identifiers of the threads that are sending a stop."""

        self._unsent: list[tuple[EventSlot, SafetyEvent | None]] = []
        self._alarms: deque[Rest] = deque()
        self._is_zero_lost = False
        """Whether the stage must still be told that its zero is lost."""

        self._commands = 0

    @property
    def is_busy(self) -> bool:
        """Whether a stop or a command is decided and may still reach the stage."""
        return self.repeated_stop.is_on_its_way or self._commands > 0

    def overtake(self) -> None:
        """Drop the commands that were decided before, because a stop is sent now, without the lock."""
        self.stops += 1

    def plan_alarm(self, rest: Rest) -> None:
        """Call `on_alarm` at the next `flush`, after the stops."""
        self._alarms.append(rest)

    def plan_unhome(self) -> None:
        """Tell the stage at the next `flush`, after the stops, that its zero is lost."""
        self._is_zero_lost = True

    def plan_events(self, *events: SafetyEvent) -> None:
        """Emit the events at the next `flush`, after all earlier ones."""
        self.events.reserve(list(events), is_ready=True)

    def plan_stop(self, events: Sequence[SafetyEvent], stop: SafetyEvent) -> None:
        """Send a stop at the next `flush`, then emit `events` and the event `stop` of the stop."""
        self.stops += 1
        self.repeated_stop.begin()
        self._unsent.append((self.events.reserve(list(events), is_ready=False), stop))

    def plan_repetition(self) -> None:
        """Send a stop once more at the next `flush`."""
        self.repeated_stop.begin()
        self._unsent.append((self.events.reserve([], is_ready=False), None))

    def plan_command(self, event: SafetyEvent) -> MotionCommand:
        """Return a command with the values of its `event`, which keeps its place among the events, for `send`."""
        self._commands += 1
        return MotionCommand(dict(event.values), event, self.events.reserve([], is_ready=False), self.stops)

    def taken(self) -> list[tuple[EventSlot, SafetyEvent | None]]:
        """Return the stops that `flush` is to send, and forget them. The caller holds the lock."""
        unsent, self._unsent = self._unsent, []
        if unsent:
            self.stopping.add(threading.get_ident())
        return unsent

    def flush(self, unsent: Sequence[tuple[EventSlot, SafetyEvent | None]]) -> None:
        """Send the stops that `taken` returned, and emit all events that are ready."""
        for slot, event in unsent:
            self._send_stop(slot, event)
        if unsent:
            self.stopping.discard(threading.get_ident())
        self.events.emit()
        if self._is_zero_lost:
            self._is_zero_lost = False
            with contextlib.suppress(DeviceFault):  # a stage that does not hear it has failed, and is stopped
                self._stage.unhome()
        while self._alarms and self._on_alarm is not None:
            with contextlib.suppress(Exception):  # an alarm that fails must prevent neither a stop nor a validation
                self._on_alarm(self._alarms.popleft())

    def send(self, command: MotionCommand, send: Callable[..., None]) -> bool:
        """Send a command, and emit its event. Return whether a stop was decided meanwhile; another stop must follow.

        A command is not sent if a stop was decided before; raises MotionRefused. Raises the DeviceFault of the stage.
        """
        try:
            if self.stops != command.stops:
                raise MotionRefused(command.event.text, (Cause.STOP_ORDERED,))
            send(*command.values.values())
            command.slot.events.append(replace(command.event, sent_ns=self._clock.now_ns()))
        finally:
            with self._lock:
                self._commands -= 1
            command.slot.is_ready = True
            self.events.emit()
        return self.stops != command.stops

    def _send_stop(self, slot: EventSlot, event: SafetyEvent | None) -> None:
        sent_ns, arrived, failed = self._clock.now_ns(), False, False
        try:
            self._stage.stop()
            arrived = True
        except DeviceFault:
            failed = True
        finally:
            with self._lock:
                now_ns = self._clock.now_ns()
                self.repeated_stop.end(sent_ns, now_ns, arrived=arrived)
                self._on_stop(failed, now_ns - sent_ns)
            if event is not None:
                slot.events.append(replace(event, sent_ns=sent_ns))
            slot.is_ready = True
