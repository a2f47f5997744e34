"""The guard of the stage: validates every sample, and every command directly before the command is sent.

All devices are read through `read_device`, so the guard validates every sample as soon as it arrives. The loop calls
`tick` to report that the loop is running. `insert` and `rotate` send a command only if the state is ENABLED and every
input is fresh, valid and within limits. A command with a value beyond a limit is refused, never clipped.

A person may retract the needle (`retract`) in every state, including FAULT, and with failed sensors, because pulling
the needle out is safe. No program calls `retract` on its own; the loop moves the needle outward with `insert`. A
retraction must lead outward, and its speed is limited. If the position is unknown, only a retraction to `shallowest_mm`
is accepted. A retraction is a motion that every stop by a person stops, and that may be ordered again. A blocked guard
and a stage that moves the wrong way or jumps stop it too; other causes and the orders of the loop do not. A retraction
is in force until the stage rests, a stop or another retraction; until then ENABLE and RESUME are refused, so the loop
never moves the needle against a retraction.

The function `advance` decides about all transitions. The guard decides with its lock held, and sends with the lock
released: a stop that the stage does not answer blocks no other thread. A command that was decided before a stop, and
may have reached the stage after it, is followed by another stop. A stop is repeated while the needle does not stand
still, until it was measured at rest or a retraction begins; until then, ENABLE and RESUME wait. If the needle moves in
spite of a stop, or its rest is unknown, the heartbeats are withheld and `on_alarm` is called. The guard is software and
does not replace an emergency stop that cuts the power of the drives.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Collection
from dataclasses import replace

from needleplan.control.safety._causes import Cause, Owner
from needleplan.control.safety._core import _AS_ARGUMENT, GuardCore
from needleplan.control.safety._events import SafetyEventName
from needleplan.control.safety._limits import SafetyLimits, against_insertion, against_retraction, against_rotation
from needleplan.control.safety._states import InputReport, MotionOrder, OperatingState, Order, SafetyState, advance
from needleplan.devices import Health, Sample, SampledDevice, Source, Stage, StageSample
from needleplan.errors import DeviceFault, MotionRefused
from needleplan.recording import RecorderStatus

__all__ = ["GuardedStage"]


class GuardedStage(GuardCore, Stage):
    """A stage whose `insert` and `rotate` require that all checks pass. Raises MotionRefused if `stage` has a guard.

    Limits laxer than the defaults need a reason in `accepted_limits`; without it, SafetyError is raised.

    `listener` receives every event, in order; a stop is sent before its event. The listener must return at once and
    must not call the guard; its exception is the cause RECORDING_LOST. After each stop, the first thread that calls
    `insert` or `rotate` is the only one that may do so. Any thread may call all other methods. If another thread blocks
    the guard for more than 40 ms, a call sends a stop and raises MotionRefused; `stop`, `close` and successful reads
    do not raise.
    """

    @property
    def stage_has_failed(self) -> bool:
        """Whether the last attempt to read the stage has raised an error; `measure` may still have samples."""
        return self._monitor.read_failed

    @property
    def retraction_s(self) -> float:
        """Longest duration (s) of the retraction in force: twice the nominal duration plus 2 s; 0 without one."""
        goal, last = self._monitor.motion.depth, self._monitor.inputs.stage.last
        if goal is None or not goal.is_retraction:
            return 0.0
        way_mm = (self._limits.deepest_mm if last is None else last.depth_mm) - goal.end
        return 2 * max(way_mm, 0.0) / goal.velocity + 2.0

    @property
    def homed(self) -> bool | None:
        """Whether the stage itself knows its zero; None if it does not tell."""
        return self._stage.homed

    def exchange_limits(self, limits: SafetyLimits, accepted_limits: str = "") -> None:
        """Replace the limits; raises MotionRefused unless the state is DISABLED, SafetyError as the constructor."""
        limits.require_accepted(accepted_limits, _AS_ARGUMENT)
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
            self._monitor.observe(sample, tip, self._limits)
            return self._validate(now_ns)

    def observe_tip(self, tip_mm: tuple[float, float] | None, out_of_plane_mm: float) -> SafetyState:
        """Validate a new tip estimate: its position in the plane (None if lost) and its distance from the plane."""
        with self._held() as now_ns:
            self._monitor.observe_tip(tip_mm, out_of_plane_mm)
            return self._validate(now_ns)

    def observe_deadman(self, *, held: bool) -> SafetyState:
        """Validate a signal of the deadman switch; without a signal for `deadman_age_s` the switch counts as released.

        Matters only for a guard that needs a deadman switch.
        """
        with self._held() as now_ns:
            self._monitor.observe_deadman(held, now_ns)
            return self._validate(now_ns)

    def device_failed(self, source: Source, error: Exception) -> SafetyState:
        """Mark a device as failed until its next usable sample, validate all inputs, and return the state."""
        return self._mark_failed(source, str(error))

    def report(self, causes: Collection[Cause], text: str = "") -> SafetyState:
        """Replace the causes that the loop reports, such as PLAN_LOST, validate all inputs, and return the state."""
        with self._held() as now_ns:
            self._monitor.reported = frozenset(causes)
            return self._validate(now_ns, text)

    def observe_recording(self, status: RecorderStatus) -> SafetyState:
        """Validate the status of the recorder, and return the state. A lost message is a fault, a delay is a pause."""
        with self._held() as now_ns:
            self._monitor.recording = self._monitor.recording.then(status, now_ns)
            return self._validate(now_ns, status.cause)

    def tick(self) -> SafetyState:
        """Report that the loop is running, validate all inputs, and return the state. The loop calls `tick` regularly.

        Only this method sends heartbeats to the stage, at most one in 4.5 ms. If the loop ends or hangs, the heartbeats
        cease, and the watchdog of the stage stops the motion. The heartbeats also cease if the needle moves in spite of
        a stop. If a heartbeat cannot be sent, the stage has failed.
        """
        with self._held() as now_ns:
            # Validated before the time of the last tick is replaced, so that a late tick is detected.
            state = self._validate(now_ns)
            self._monitor.ticked(now_ns)
            self._ticker = threading.get_ident()
            if Cause.LOOP_LATE in state.present:
                self._validate(now_ns)
        if self._alarms:
            self._supervision.withhold()
        elif not self._supervision.tick() and (error := self._heartbeat.send(now_ns)) is not None:
            return self.device_failed(Source.STAGE, error)
        return self._state

    def heartbeat(self) -> None:
        """Call `tick`."""
        self.tick()

    def check(self) -> SafetyState:
        """Validate all inputs for the Watchdog thread, and return the state; this does not report a running loop."""
        with self._held() as now_ns:
            return self._validate(now_ns)

    def fail(self, error: Exception) -> SafetyState:
        """Stop both axes at once after an unexpected `error` in a validation; GUARD_FAILED is a fault of the run."""
        self._wire.overtake()
        with contextlib.suppress(DeviceFault):
            self._stage.stop()
        with self._held() as now_ns:
            report = InputReport(self._state.present | {Cause.GUARD_FAILED}, self._state.is_busy)
            self._follow(advance(self._state, report, now_ns), now_ns, f"the guard has failed: {error!r}")
            return self._state

    def order(self, order: Order, by: str | Owner = "") -> SafetyState:
        """Validate all inputs, carry out an order, and return the state.

        `by` is the name of the person who gives the order, or the Owner if it is not a person. If the stage has lost
        its zero, the guard refuses ENABLE, and accepts HOME of a person only; this HOME is passed on to the stage.
        Raises MotionRefused with all causes of the refusal, or the DeviceFault of the stage.
        """
        owner = by if isinstance(by, Owner) else Owner.PERSON
        is_found = order is Order.HOME and owner is Owner.PERSON and self._stage.homed is False
        if is_found and not advance(self._state, order.by(owner), 0).refused:
            self._stage.home()
        with self._held() as now_ns:
            self._validate(now_ns)
            transition = advance(self._state, order.by(owner), now_ns)
            is_lost = self._stage.homed is False and order in (Order.HOME, Order.ENABLE)
            if transition.refused or is_lost:
                against = transition.causes | {Cause.NOT_HOMED} if is_lost else transition.causes
                self._refuse(order, against, now_ns, _name(by))
            if self._state.operating is OperatingState.DISABLED and order is Order.ENABLE:
                self._monitor.loop = replace(self._monitor.loop, enabled_ns=now_ns)
            self._obey(order, transition, now_ns, _name(by))
            return self._state

    def insert(self, depth_mm: float, velocity_mm_s: float) -> None:
        """Begin to move to a depth at a speed. Raises MotionRefused if a check fails, or the stage's DeviceFault."""
        with self._held() as now_ns:
            self._validate(now_ns)
            limits, request = self._limits, f"insert to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._monitor.inputs.stage_known(limits, now_ns)
            self._require_none(request, against_insertion(limits, here, depth_mm, velocity_mm_s), now_ns)
            self._monitor.motion = self._monitor.motion.inserts(depth_mm, velocity_mm_s, now_ns)
            values = {"depth_mm": depth_mm, "velocity_mm_s": velocity_mm_s}
            command = self._command(SafetyEventName.COMMAND, values, request, now_ns)
        self._send(command, self._stage.insert)

    def rotate(self, roll_rad: float, velocity_rad_s: float) -> None:
        """Begin to rotate the base to a roll. Raises MotionRefused if a check fails, or the stage's DeviceFault."""
        with self._held() as now_ns:
            self._validate(now_ns)
            request = f"rotate to {roll_rad:g} rad at {velocity_rad_s:g} rad/s"
            self._require_none(request, against_rotation(self._limits, roll_rad, velocity_rad_s), now_ns)
            self._monitor.motion = self._monitor.motion.rotates(roll_rad, velocity_rad_s, now_ns)
            values = {"roll_rad": roll_rad, "velocity_rad_s": velocity_rad_s}
            command = self._command(SafetyEventName.COMMAND, values, request, now_ns)
        self._send(command, self._stage.rotate)

    def retract(self, depth_mm: float, velocity_mm_s: float, by: str = "") -> None:
        """Begin to pull the needle out to a depth, by order of the person `by`, in every state; ENABLED becomes PAUSED.

        Raises MotionRefused if the goal is not outward or a value is not permitted, or the DeviceFault of the stage.
        """
        with self._held() as now_ns:
            limits, request = self._limits, f"retract to {depth_mm:g} mm at {velocity_mm_s:g} mm/s"
            here = self._monitor.inputs.stage_known(limits, now_ns)
            against = against_retraction(limits, here, depth_mm, velocity_mm_s)
            if against:
                self._refuse(request, against, now_ns, by)
            self._obey_waiting(now_ns)  # a stop that was ordered before must not stop the retraction
            transition = advance(self._state, MotionOrder.RETRACT.by(Owner.PERSON), now_ns)
            # From here on, no other cause stops the needle, and no earlier stop is repeated, unless the stage refuses.
            self._follow(transition, now_ns, request)
            self._monitor.stop, self._has_moved = None, True
            self._monitor.motion = self._monitor.motion.retracts(depth_mm, velocity_mm_s, now_ns)
            self._supervision.post(limits, self._state, self._monitor, by_person=True)
            values = {"depth_mm": depth_mm, "velocity_mm_s": velocity_mm_s}
            command = self._command(SafetyEventName.RETRACTION, values, request, now_ns, by or "a person")
        try:
            self._send(command, self._stage.insert)
        except DeviceFault:
            with self._held() as now_ns:
                self._monitor.motion = self._monitor.motion.stops(now_ns)
                self._validate(now_ns)  # the retraction is over, and its end is a stop
            raise
        self.retractions += 1

    def stop(self) -> None:
        """Stop both axes in every state, and refuse ENABLE until the order RESET.

        A stop is sent at once, without the lock of the guard. If another thread blocks the guard, the next validation
        carries out the order.
        """
        with contextlib.suppress(DeviceFault):
            self.send_stop()
        try:
            self.order(Order.STOP, "stop()")
        except MotionRefused:
            self._stop_waits = True

    def send_stop(self) -> None:
        """Send one stop, without the lock of the guard and without waiting for an answer. Raises DeviceFault.

        A signal handler may call this method. An order must follow; without it, the loop may go on.
        """
        self._wire.overtake()
        self._stage.send_stop()

    def measure(self, timeout_s: float) -> StageSample | None:
        """Return the next sample of the stage, also during a fault, and measure by it whether a stopped needle rests.

        The sample does not count as an input of the run. Raises DeviceFault if the stage does not answer.
        """
        sample = self._stage.measure(timeout_s)
        with contextlib.suppress(MotionRefused), self._held() as now_ns:
            if sample is not None and sample.health is Health.GOOD:
                self._monitor.see_stopping(sample, sample.stamp.received_ns * 1e-9)
            self._validate(now_ns)
        return sample

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
        if source in (Source.FIBRE, Source.IMAGE):  # they only improve the estimate of the tip
            unwatched: Sample | None = device.read(timeout_s)
            return unwatched
        try:
            sample: Sample | None = device.read(timeout_s)
        except Exception as error:
            self._monitor.read_failed |= source is Source.STAGE
            self.device_failed(source, error)
            raise
        if source is Source.STAGE:
            self._monitor.read_failed = False
        if sample is not None:
            # If the guard is blocked, it has sent a stop; the sample itself is still valid.
            with contextlib.suppress(MotionRefused):
                self._observe(sample, None)
        return sample

    def close(self) -> None:
        """Disable the guard, stop and close the stage, and permit another guard for the stage."""
        with contextlib.suppress(MotionRefused), self._held() as now_ns:
            self._follow(advance(self._state, Order.DISABLE.by(Owner.PERSON), now_ns), now_ns, "close")
        self._stage.close()
        self._give_back()


def _name(by: str | Owner) -> str:
    return f"the {by.value}" if isinstance(by, Owner) else by
