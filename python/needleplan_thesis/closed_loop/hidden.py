"""Tissues, needles and bases of the lab twin that hide something from a plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from needleplan.errors import InputError, Mistake
from needleplan.scenario import CurvaturePiece, Scenario
from needleplan.simulation import Effects, Robot, Setup, Shaft, SimulatedEntry

__all__ = ["HIDDEN", "NOTHING", "SHAFT", "Hidden", "hidden_named", "laboratory"]

_WANDER = 5e-4
_TRACKER_MM = 0.1
_SERVO_HZ = 400
"""Less than the twin's own: its samples are most of what an insertion costs."""

SHAFT = Shaft(torsional_stiffness_n_mm2=1.5e4)


@dataclass(frozen=True)
class Hidden:
    """What a lab hides: `hide` puts it into a lab that is as planned."""

    name: str
    title: str
    truth: str
    """In the words of the diagnosis, where it has them."""

    hide: Callable[[Setup], Setup]


def laboratory(scenario: Scenario, entry: SimulatedEntry | None = None) -> Setup:
    """Return a lab that bends as planned, with a tracker of 0.1 mm and a heading that wanders a little."""
    return Setup(
        plan_curvature_per_mm=1 / scenario.needle.curvature_radius_mm, scenario=scenario,
        entry=entry or SimulatedEntry(),
        effects=Effects(heading_noise_rad_sqrt_mm=_WANDER, tracker_noise_mm=_TRACKER_MM), shaft=SHAFT,
        robot=Robot(servo_hz=_SERVO_HZ),
    )  # fmt: skip


def _layers(pieces: Sequence[tuple[float, float]]) -> Callable[[Setup], Setup]:
    """Hide tissue in which the path bends otherwise: from where on (mm along x), and the share of the planned."""

    def hide(setup: Setup) -> Setup:
        assert setup.scenario is not None
        bend = setup.plan_curvature_per_mm
        changed = setup.scenario.with_curvature([CurvaturePiece(begin, share * bend) for begin, share in pieces])
        return replace(setup, scenario=changed)

    return hide


def _effect(**sizes: Any) -> Callable[[Setup], Setup]:
    return lambda setup: replace(setup, effects=replace(setup.effects, **sizes))


def _tilted(setup: Setup) -> Setup:
    return replace(setup, entry=replace(setup.entry, heading_rad=setup.entry.heading_rad + 0.04))


_SKIN = [(float(x), 0.4 + 0.6 * x / 20) for x in np.arange(0.0, 20.0, 2.0)] + [(20.0, 1.0)]

NOTHING = Hidden("nothing", "all is as planned", "", lambda setup: setup)
HIDDEN: tuple[Hidden, ...] = (
    Hidden("soft_layer", "from 25 mm on the path bends 25 % less", "a layer of size -0.25 from 26 mm of the path on",
           _layers([(0.0, 1.0), (25.0, 0.75)])),
    Hidden("stiff_layer", "from 35 mm on the path bends 35 % more", "a layer of size 0.35 from 36 mm of the path on",
           _layers([(0.0, 1.0), (35.0, 1.35)])),
    Hidden("guiding_skin", "the path bends 60 % less at the entry, and as planned from 20 mm on",
           "size -0.6 at the entry, falling linearly over 20 mm", _layers(_SKIN)),
    Hidden("speed", "the curvature falls with the fourth root of the speed", "size -0.16 from 5 to 10 mm/s",
           _effect(curvature_speed_power=-0.25)),
    Hidden("torsion", "the tissue holds the shaft: at 60 mm the tip is 12 degrees behind the base",
           "lag of 0.0040 rad/mm at first, 0.0033 at 70 mm", _effect(torsional_friction_n=0.3)),
    Hidden("bent_needle", "the needle is bent across its bevel, a fifth as much as it steers",
           "size 0.002 1/mm at a right angle to the bevel", _effect(pre_bend_per_mm=0.002)),
    Hidden("sagging_needle", "the weight of the needle bends the path downwards", "size 0.0015 1/mm, downwards",
           _effect(sag_per_mm=0.0015)),
    Hidden("misaligned_base", "the needle goes in 2.3 degrees beside the planned direction",
           "size 0.04 rad, in the plane to the left", _tilted),
)  # fmt: skip
"""Each for a plan with a radius of 100 mm."""


def hidden_named(name: str) -> Hidden:
    """Return the hidden effect of a name. Raises InputError where there is none."""
    for each in (NOTHING, *HIDDEN):
        if each.name == name:
            return each
    raise InputError(Mistake("hidden effect", name, f"must be one of {', '.join(each.name for each in HIDDEN)}"))
