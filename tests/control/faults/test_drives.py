"""Faults 28 and 29 of drives on a CAN bus through the guard: FAULT for the stage, and the axes come to rest."""

import contextlib
import time
from collections.abc import Callable
from dataclasses import replace

import pytest

pytest.importorskip("canopen", reason="the library canopen is not installed (extra: canopen)")

from needleplan.control.safety import (
    Cause,
    GuardedStage,
    OperatingState,
    Order,
    SafetyEvent,
    SafetyEventName,
    SafetyLimits,
)
from needleplan.devices import ForceSample, PoseSample, Stamp
from needleplan.devices.cia402 import CanopenStage, SimulatedDrives
from needleplan.devices.cia402.objects import Cia402State
from needleplan.errors import DeviceFault, MotionRefused
from tests.devices.cia402.bench import PATIENT, drives, stage_on, wait_for

QUICK = replace(PATIENT, silence_s=1.0, answer_s=1.0, change_s=1.5)
AGE_S = 10.0
LIMITS = SafetyLimits(
    force_age_s=AGE_S, pose_age_s=AGE_S, stage_age_s=AGE_S, loop_age_s=AGE_S, motion_s=AGE_S, following_mm=5.0,
    insertion_velocity_mm_s=50.0,
)  # fmt: skip
"""For a machine with other things to do: here the drives say what is wrong, not the clock."""


def mute(there: SimulatedDrives, _: CanopenStage) -> None:
    there.roll.faults.mute = True


def trip(there: SimulatedDrives, _: CanopenStage) -> None:
    there.insertion.trip(0x2310)


def gone(_: SimulatedDrives, stage: CanopenStage) -> None:
    stage._bus.network.bus.shutdown()


def restart(there: SimulatedDrives, _: CanopenStage) -> None:
    there.roll.restart()


def turn(guard: GuardedStage, number: int) -> None:
    with contextlib.suppress(DeviceFault):
        guard.read(0.05)
    stamp = Stamp(time.monotonic_ns(), number)
    guard.observe(ForceSample(stamp, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
    guard.observe(PoseSample(stamp, (0, 0, 0.01 * (number % 2)), (1, 0, 0, 0), 0.1), tip_mm=(0, 0), out_of_plane_mm=0.0)
    guard.tick()


@pytest.mark.parametrize("inject", [trip, mute, gone, restart])
def test_28_29_it_is_a_fault_and_the_axes_come_to_rest(
    inject: Callable[[SimulatedDrives, CanopenStage], None],
) -> None:
    events: list[SafetyEvent] = []
    with drives() as there, stage_on(there, QUICK) as stage:
        guard = GuardedStage(stage, LIMITS, listener=events.append, accepted_limits="a busy machine")
        turn(guard, 0)
        turn(guard, 1)
        guard.order(Order.HOME, "anna")
        guard.order(Order.ENABLE, "anna")
        guard.insert(100.0, 20.0)
        inject(there, stage)
        number = 2
        while guard.state.operating is OperatingState.ENABLED:
            turn(guard, number)
            number += 1
        first = next(each for each in events if each.name is SafetyEventName.TRANSITION and each.before == "ENABLED")
        assert first.state is OperatingState.FAULT
        assert Cause.STAGE_FAULT in first.causes
        assert first.text, "it says what the drive said"
        with pytest.raises(MotionRefused, match="stage_fault"):
            guard.insert(100.0, 20.0)
        if inject is not gone:  # who is cut off is stopped by the drive's own watchdog, which here is patient
            wait_for(lambda: there.insertion.at_rest and there.insertion.state is not Cia402State.ENABLED)
        there.roll.faults.mute = False
