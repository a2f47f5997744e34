"""What is against the values of a command, whatever the state: pure."""

from __future__ import annotations

import math

from needleplan.control.safety.causes import Cause
from needleplan.control.safety.limits import SafetyLimits
from needleplan.devices import StageSample

__all__ = ["against_insertion", "against_retraction", "against_rotation"]

_NOT_FINITE = frozenset({Cause.NOT_FINITE})


def against_insertion(
    limits: SafetyLimits, here: StageSample | None, depth_mm: float, velocity_mm_s: float
) -> frozenset[Cause]:
    """Return what is against going to a depth from `here`, which is None where it is not known."""
    if not (math.isfinite(depth_mm) and math.isfinite(velocity_mm_s)):
        return _NOT_FINITE
    inward = here is None or depth_mm > here.depth_mm
    fastest = limits.insertion_velocity_mm_s if inward else limits.retraction_velocity_mm_s
    against = set()
    if not limits.shallowest_mm <= depth_mm <= limits.deepest_mm:
        against.add(Cause.DEPTH_BEYOND)
    if not 0 < velocity_mm_s <= fastest:
        against.add(Cause.VELOCITY_BEYOND)
    return frozenset(against)


def against_rotation(limits: SafetyLimits, roll_rad: float, velocity_rad_s: float) -> frozenset[Cause]:
    """Return what is against turning the base to a roll."""
    if not (math.isfinite(roll_rad) and math.isfinite(velocity_rad_s)):
        return _NOT_FINITE
    against = set()
    if abs(roll_rad) > limits.roll_rad:
        against.add(Cause.ROLL_BEYOND)
    if not 0 < velocity_rad_s <= limits.rotation_velocity_rad_s:
        against.add(Cause.ROTATION_BEYOND)
    return frozenset(against)


def against_retraction(
    limits: SafetyLimits, here: StageSample | None, depth_mm: float, velocity_mm_s: float
) -> frozenset[Cause]:
    """Return what is against pulling the needle out; from where nobody knows, only all the way out will do."""
    if not (math.isfinite(depth_mm) and math.isfinite(velocity_mm_s)):
        return _NOT_FINITE
    against = set()
    if depth_mm > (limits.shallowest_mm if here is None else here.depth_mm):
        against.add(Cause.NOT_A_RETRACTION)
    if depth_mm < limits.shallowest_mm:
        against.add(Cause.DEPTH_BEYOND)
    if not 0 < velocity_mm_s <= limits.retraction_velocity_mm_s:
        against.add(Cause.VELOCITY_BEYOND)
    return frozenset(against)
