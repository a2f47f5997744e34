"""Stop a stage that this program controls, and measure that it rests."""

from __future__ import annotations

from collections.abc import Callable

from needleplan.bystander import StopOutcome
from needleplan.devices._base import Stage
from needleplan.devices._clock import Clock, SystemClock
from needleplan.errors import DeviceFault
from needleplan.stopping import Rest, StopLimits, StopProcedure, limits_at_any_speed

__all__ = ["halt"]

# time (s) after which the stop is sent again while the needle moves, and longest wait (s) for a sample
_AGAIN_S, _TURN_S = 0.02, 0.01


def halt(
    stage: Stage, within_s: float, on_alarm: Callable[[StopOutcome], object] | None = None, *,
    limits: StopLimits | None = None, clock: Clock | None = None,
) -> StopOutcome:  # fmt: skip
    """Stop both axes of a stage that has no guard, until the stage is measured at rest or a time has passed.

    The stop is repeated while the needle moves. No heartbeat is sent once the needle moves in spite of the stop, so
    that the watchdog of the stage acts too.

    Parameters
    ----------
    stage : Stage
        Stage. Its errors are noted in the result, not raised.
    within_s : float
        Longest time (s).
    on_alarm : callable, optional
        Called with the present outcome once if the needle still moves, and once if its position is unknown.
    limits : StopLimits, optional
        Limits at rest. Default: `limits_at_any_speed()`.
    clock : Clock, optional
        Clock. Default: the clock of the system.

    Returns
    -------
    StopOutcome
    """
    clock = SystemClock() if clock is None else clock
    begun_s = clock.now_ns() / 1e9
    procedure = StopProcedure(limits_at_any_speed() if limits is None else limits, begun_s)
    alarms, sent, sent_s, result, obstacle = {Rest.MOVES, Rest.UNKNOWN}, 0, begun_s, None, ""
    while True:
        now_s = clock.now_ns() / 1e9
        if not sent or (now_s - sent_s >= _AGAIN_S and not procedure.stands):
            sent, sent_s = sent + 1, now_s
            try:
                stage.stop()
                result = 0
                procedure.arrived(clock.now_ns() / 1e9)
            except DeviceFault as fault:
                obstacle = str(fault)
        try:
            if len(alarms) == 2:
                stage.heartbeat()
            sample = stage.measure(_TURN_S)
        except DeviceFault as fault:
            sample, obstacle = None, str(fault)
            clock.sleep(_TURN_S)
        if sample is not None:
            stamp = sample.stamp
            numbers = sample.depth_mm, sample.velocity_mm_s, sample.roll_rad
            procedure.see(stamp.received_ns / 1e9, *numbers, stamp.device_time_s)
        now_s = clock.now_ns() / 1e9
        outcome = StopOutcome(result, now_s - begun_s, sent, obstacle, procedure.rest(now_s), procedure.moved_mm)
        if outcome.rest in alarms:
            alarms.remove(outcome.rest)
            if on_alarm is not None:
                on_alarm(outcome)
        if outcome.is_confirmed or now_s - begun_s >= within_s:
            return outcome
