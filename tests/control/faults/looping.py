"""A loop in a process of its own: drives the robot at argv[1], and prints every event of its guard as a line of JSON.

argv[2] is `collect` where it is to collect garbage, a lot of it, as soon as it hears a line on its standard input.
"""

import contextlib
import gc
import json
import os
import sys
import threading
import time

from needleplan.control.safety import GuardedStage, OperatingState, Order, SafetyEvent, SafetyLimits, Watchdog
from needleplan.devices import ForceSample, PoseSample, Stamp
from needleplan.devices.robot import RobotStage
from needleplan.errors import DeviceFault

GARBAGE = 3_000_000
PATIENCE = 100
"""Turns after which it ends where it is not enabled any more."""


def say(event: SafetyEvent) -> None:
    os.write(1, json.dumps(event.entry() | {"time_ns": event.time_ns}).encode() + b"\n")


def turn(guard: GuardedStage, number: int) -> None:
    with contextlib.suppress(DeviceFault):
        guard.read(0.002)
    stamp = Stamp(time.monotonic_ns(), number)
    guard.observe(ForceSample(stamp, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0)))
    guard.observe(
        PoseSample(stamp, (0.0, 0.0, 0.01 * (number % 2)), (1.0, 0.0, 0.0, 0.0), 0.1),
        tip_mm=(0, 0),
        out_of_plane_mm=0.0,
    )
    guard.tick()


def main() -> None:
    asked = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), asked.set()), daemon=True).start()
    # On a busy machine the loop itself must not be what is late.
    limits = SafetyLimits(force_age_s=0.15, pose_age_s=0.15, stage_age_s=0.15, loop_age_s=0.15)
    garbage: list[list[object]] = []
    if sys.argv[2] == "collect":
        gc.disable()
        for _ in range(GARBAGE):
            ring: list[object] = []
            ring.append(ring)
            garbage.append(ring)
    with RobotStage.open(f"{sys.argv[1]}?watchdog_s=0.1&valid_s=0.1") as stage:
        guard = GuardedStage(stage, limits, listener=say, accepted_limits="a busy machine")
        with Watchdog(guard):
            number, enabled, collected, refused = 0, False, False, 0
            while refused < PATIENCE:
                number += 1
                refused += enabled and guard.state.operating is not OperatingState.ENABLED
                with contextlib.suppress(DeviceFault):
                    turn(guard, number)
                    if not enabled and not guard.state.present:
                        guard.order(Order.HOME)
                        guard.order(Order.ENABLE)
                        enabled = True
                    if enabled:
                        guard.insert(150.0, 1.0)
                if asked.is_set() and not collected:
                    collected = True
                    garbage.clear()
                    began = time.monotonic()
                    gc.collect()
                    os.write(1, json.dumps({"name": "collected", "took_s": time.monotonic() - began}).encode() + b"\n")


main()
