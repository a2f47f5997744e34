"""A draft of an effect: a Python file of the plug-in interface that holds what was described, for a person to name."""

from __future__ import annotations

import json

from needleplan.diagnosis.curves import Curve, Curves
from needleplan.diagnosis.formula import Formula
from needleplan.diagnosis.measurand import Axis

__all__ = ["draft_text"]

_AXES = {
    Axis.TIME: "time", Axis.DEPTH: "depth", Axis.SPEED: "speed", Axis.FORCE: "force", Axis.HOLD: "time at rest",
    Axis.PERIOD: "depth", Axis.ANGLE: "angle",
}  # fmt: skip
_VALUES = {Axis.TIME: "time_s", Axis.SPEED: "abs(velocity_mm_s)", Axis.FORCE: "force_n"}
_WAYS = {"advance": "(sign > 0)", "retraction": "(sign < 0)", "any": "1.0"}

_TEMPLATE = '''\
"""A draft of an effect that no name is known for. It describes the recordings, and explains nothing.

{description}

What to do with it: find out what acts like this; replace `drawn` by the law of that; give it a name, a family, where it
enters (TIP, SHAFT, TISSUE or SENSOR), and a source. Then look for it beside all others:

    needleplan diagnose MODEL.toml DATA... -o DIR --effects effect_to_name.py

A package makes it known to every command by the entry point `needleplan.effects`, which names EFFECT.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy import abs, cos, exp, interp, pi, sin  # noqa: A004, F401

from needleplan.models.effects import Enters, Family, Term, TermEffect
from needleplan.models import parameter


def drawn(depth_mm, velocity_mm_s, sign, time_s, force_n):
    """What was missing, in N, with an RMS of 1 N in the training data.

    depth_mm is 0 in the air; sign is +1 on the way in, -1 on the way out, and in a rest what it was before; force_n is
    that of the model without it.
    """
    return {expression}


@dataclass(frozen=True, kw_only=True)
class Draft(Term):
    """The draft, without a memory."""

    name: ClassVar[str] = {name}
    order: ClassVar[int] = 0
    size: float = parameter("N", -20, 20, "RMS of what was missing", typical={typical!r})

    def initial(self, motion):
        """Return no memory."""
        return np.zeros(0)

    def rate(self, state, motion):
        """Return no memory."""
        return state

    def states(self, motion, start):
        """Return no memory."""
        return np.zeros((0, len(motion)))

    def shape(self, state, motion, plain):
        """Return what is added for size 1."""
        depth = np.maximum(np.asarray(motion.depth_mm, float), 0.0)
        rows = motion.velocity_mm_s, motion.direction, motion.time_s, plain
        return np.asarray(drawn(depth, *(np.asarray(row, float) for row in rows)) + np.zeros_like(depth))


EFFECT = TermEffect(
    name={name},
    title="draft: a gap along {axis}",
    family=Family.TISSUE,
    enters=Enters.SHAFT,
    equation={equation},
    meaning="A gap along {axis} that was described and not explained.",
    source="effect_to_name.py of a diagnosis",
    term=Draft,
)
'''


def draft_text(name: str, axis: Axis, curves: Curves, formula: Formula | None, rms: float) -> str:
    """Return the text of the file: the formula, or else the curves, over their RMS in the training data (N)."""
    if formula is not None:
        expression = " + ".join(f"{each.size / rms!r} * {each.text}" for each in formula.terms)
        equation = formula.text
    else:
        expression = _table(axis, curves, rms)
        equation = f"a table over {_AXES[axis]}, see drawn"
    return _TEMPLATE.format(
        description=_description(axis, formula),
        expression=expression,
        name=json.dumps(name),
        typical=float(f"{rms:.3g}"),
        axis=_AXES[axis],
        equation=json.dumps(equation),
    )


def _table(axis: Axis, curves: Curves, rms: float) -> str:
    parts = [_part(axis, each, rms) for each in curves.curves if each.inside.any()]
    return "(\n        " + "\n        + ".join(parts or ["0.0 * depth_mm"]) + "\n    )"


def _part(axis: Axis, curve: Curve, rms: float) -> str:
    places = [float(f"{each:.5g}") for each in curve.places[curve.inside]]
    values = [float(f"{each / rms:.4g}") for each in curve.mean[curve.inside]]
    along = _VALUES.get(axis, "depth_mm")
    return f"{_WAYS.get(curve.way, '(abs(velocity_mm_s) < 1e-9)')} * interp({along}, {places}, {values})"


def _description(axis: Axis, formula: Formula | None) -> str:
    lines = [f"It lies along {_AXES[axis]}."]
    if formula is None:
        lines.append("No short formula passes the gates: the table below is its curve, inside of what was visited.")
        return "\n".join(lines)
    kept = "" if formula.transfer is None else f"; in another motion it keeps {formula.transfer:.0%} of its promise"
    lines.append(f"As a formula, in N: {formula.text}")
    lines.append(f"It has {formula.share:.0%} of what the best smooth function gains{kept}.")
    if formula.alike:
        lines.append("Its first product could as well be: " + "; ".join(formula.alike[:6]))
    return "\n".join(lines)
