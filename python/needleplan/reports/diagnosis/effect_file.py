"""An effect file: Python source of an effect with the shape of an unexplained gap, to be completed by the user."""

from __future__ import annotations

import json

from needleplan.diagnosis import Curve, Curves, GapAxis

__all__ = ["effect_file_text"]

# Name of each axis in the texts of the file.
_AXES = {
    GapAxis.TIME: "time", GapAxis.DEPTH: "depth", GapAxis.SPEED: "speed", GapAxis.FORCE: "force",
    GapAxis.DWELL: "time at rest", GapAxis.PERIOD: "depth", GapAxis.ANGLE: "angle",
}  # fmt: skip

# Expression in `drawn` for the variable of an axis; for an axis that is not listed: `depth_mm`.
_VARIABLES = {GapAxis.TIME: "time_s", GapAxis.SPEED: "abs(velocity_mm_s)", GapAxis.FORCE: "force_n"}

# Factor in `drawn` that is 1 while the needle moves in this way, else 0; for a way not listed: 1 at rest.
_WAYS = {"advance": "(sign > 0)", "retraction": "(sign < 0)", "any": "1.0"}


_TEMPLATE = '''\
"""A draft of an effect for an unexplained gap. It describes the recordings, but does not explain the cause.

{description}

Find the physical cause, replace the body of `drawn` by its law, and set name, family, source and `enters`
(TIP, SHAFT, TISSUE or SENSOR: where the effect acts). Then diagnose with this effect and all others:

    needleplan diagnose MODEL.toml DATA... -o DIR --effects effect_to_name.py

To add the effect to every command, install a package with an entry point of the group `needleplan.effects` that names
EFFECT.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy import abs, cos, exp, interp, pi, sin  # noqa: A004, F401

from needleplan.models.effects import Enters, Family, Term, TermEffect
from needleplan.models import parameter


def drawn(depth_mm, velocity_mm_s, sign, time_s, force_n):
    """Missing force (N), scaled to an RMS of 1 N in the training data.

    depth_mm is 0 in the air. sign is +1 during insertion and -1 during retraction, and keeps its value during a dwell.
    force_n is the force of the model without the effect.
    """
    return {expression}


@dataclass(frozen=True, kw_only=True)
class Draft(Term):
    """The draft: an effect without internal state."""

    name: ClassVar[str] = {name}
    order: ClassVar[int] = 0
    size: float = parameter("N", -20, 20, "RMS of the missing force", typical={typical!r})

    def initial(self, motion):
        """Return the initial internal state: empty."""
        return np.zeros(0)

    def rate(self, state, motion):
        """Return the rate of the internal state: empty."""
        return state

    def states(self, motion, start):
        """Return the internal states along the motion: shape (0, samples)."""
        return np.zeros((0, len(motion)))

    def shape(self, state, motion, plain):
        """Return the added force (N) at size 1, shape (samples,)."""
        depth = np.maximum(np.asarray(motion.depth_mm, float), 0.0)
        rows = motion.velocity_mm_s, motion.direction, motion.time_s, plain
        return np.asarray(drawn(depth, *(np.asarray(row, float) for row in rows)) + np.zeros_like(depth))


EFFECT = TermEffect(
    name={name},
    title="draft: a gap along {axis}",
    family=Family.TISSUE,
    enters=Enters.SHAFT,
    equation={equation},
    meaning="A gap along {axis}, described but not explained.",
    source="effect_to_name.py of a diagnosis",
    term=Draft,
)
'''


def effect_file_text(course: Curves, name: str = "my_effect") -> str:
    """Return Python source of the effect `name` with the shape of a gap, as a table of its curves."""
    axis = _AXES[course.axis]
    return _TEMPLATE.format(
        description=f"The gap depends on {axis}. The table below is its curve within the visited range.",
        expression=_table(course.axis, course, course.rms),
        name=json.dumps(name),
        typical=float(f"{course.rms:.3g}"),
        axis=axis,
        equation=json.dumps(f"a table along {axis}, see drawn"),
    )


def _table(axis: GapAxis, curves: Curves, rms: float) -> str:
    parts = [_part(axis, each, rms) for each in curves.curves if each.inside.any()]
    return "(\n        " + "\n        + ".join(parts or ["0.0 * depth_mm"]) + "\n    )"


def _part(axis: GapAxis, curve: Curve, rms: float) -> str:
    places = [float(f"{each:.5g}") for each in curve.places[curve.inside]]
    values = [float(f"{each / rms:.4g}") for each in curve.mean[curve.inside]]
    along = _VARIABLES.get(axis, "depth_mm")
    return f"{_WAYS.get(curve.way, '(abs(velocity_mm_s) < 1e-9)')} * interp({along}, {places}, {values})"
