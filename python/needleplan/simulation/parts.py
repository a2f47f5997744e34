"""What a simulated experiment is made of: one frozen dataclass a table, one rule a number.

Lengths in mm, forces in N, times in s, angles in rad. A part checks itself and raises ExperimentError with all its
mistakes.
"""

from __future__ import annotations

from dataclasses import MISSING, dataclass, field
from typing import Any

from needleplan.errors import ExperimentError
from needleplan.scenario.parts import Part, checked
from needleplan.scenario.rules import Integer, Maybe, Number, Rule

__all__ = ["Entry", "Layer", "Move", "Robot", "Setting", "Shaft", "Tissue"]


def _ruled(rule: Rule, default: object = MISSING) -> Any:
    return field(default=default, metadata={"rule": rule, "key": ""})


_BEND = Number("1/mm", at_least=-1, at_most=1)
_FORCE = Number("N", at_least=0, at_most=100)
_DEPTH = Number("mm", at_least=-100, at_most=1000)


@dataclass(frozen=True)
class Setting(Part):
    """A table of an experiment; abstract."""

    def __post_init__(self) -> None:
        values, mistakes = checked(type(self), vars(self), type(self).__name__.lower())
        if mistakes:
            raise ExperimentError(mistakes)
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Entry(Setting):
    """Where the needle enters: the surface of the tissue is at `x_mm` on the line that the needle begins on.

    `depth_mm` is how far the tip is beyond the surface at the start, `roll_rad` how the base is turned there: 0 bends
    to the left, pi to the right.
    """

    x_mm: float = _ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    y_mm: float = _ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    heading_rad: float = _ruled(Number("rad", at_least=-1.6, at_most=1.6), 0.0)
    depth_mm: float = _ruled(Number("mm", at_least=-100, at_most=0), 0.0)
    roll_rad: float = _ruled(Number("rad", at_least=-7, at_most=7), 0.0)


@dataclass(frozen=True)
class Tissue(Setting):
    """The tissue where no layer says otherwise; its curvature is that of the scenario's needle unless given here."""

    curvature_per_mm: float | None = _ruled(Maybe(_BEND), None)
    cutting_n: float = _ruled(_FORCE, 0.0)
    puncture_n: float = _ruled(_FORCE, 0.0)
    stretch_mm: float = _ruled(Number("mm", above=0, at_most=50), 2.0)


@dataclass(frozen=True)
class Layer(Setting):
    """Tissue from `from_mm` behind the surface on, along the entry: other curvature, cutting force, and a membrane.

    The force on the membrane rises linearly to `puncture_n` over `stretch_mm`, and is gone once it is through. Without
    `curvature_per_mm` the needle bends as in the tissue.
    """

    from_mm: float = _ruled(Number("mm", at_least=0, at_most=1000))
    curvature_per_mm: float | None = _ruled(Maybe(_BEND), None)
    cutting_n: float = _ruled(_FORCE, 0.0)
    puncture_n: float = _ruled(_FORCE, 0.0)
    stretch_mm: float = _ruled(Number("mm", above=0, at_most=50), 2.0)


@dataclass(frozen=True)
class Shaft(Setting):
    """The needle's shaft as the twist sees it: torsional stiffness GJ, length. The default is an 18 gauge cannula."""

    torsional_stiffness_n_mm2: float = _ruled(Number("N mm^2", above=0, at_most=1e9), 1.5e4)
    length_mm: float = _ruled(Number("mm", at_least=10, at_most=1000), 200.0)


@dataclass(frozen=True)
class Robot(Setting):
    """Servo and limits of the two axes that matter: insertion and roll."""

    servo_hz: int = _ruled(Integer(200, 20_000), 1000)
    bandwidth_hz: float = _ruled(Number("Hz", at_least=1, at_most=60), 20.0)
    top_velocity_mm_s: float = _ruled(Number("mm/s", above=0, at_most=1000), 50.0)
    acceleration_mm_s2: float = _ruled(Number("mm/s^2", above=0, at_most=1e5), 100.0)
    shallowest_mm: float = _ruled(_DEPTH, -100.0)
    deepest_mm: float = _ruled(_DEPTH, 180.0)
    top_velocity_rad_s: float = _ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = _ruled(Number("rad/s^2", above=0, at_most=1e5), 60.0)


@dataclass(frozen=True)
class Move(Setting):
    """One move of a program: `insert_to_mm`, `rotate_to_rad` or `dwell_s`; the first two at a speed."""

    insert_to_mm: float | None = _ruled(Maybe(_DEPTH), None)
    velocity_mm_s: float | None = _ruled(Maybe(Number("mm/s", above=0, at_most=1000)), None)
    rotate_to_rad: float | None = _ruled(Maybe(Number("rad", at_least=-1000, at_most=1000)), None)
    velocity_rad_s: float | None = _ruled(Maybe(Number("rad/s", above=0, at_most=1000)), None)
    dwell_s: float | None = _ruled(Maybe(Number("s", above=0, at_most=3600)), None)

    @property
    def label(self) -> str:
        """What the phase of the recording is called."""
        if self.insert_to_mm is not None:
            return f"to {self.insert_to_mm:g} mm"
        return f"roll to {self.rotate_to_rad:g} rad" if self.rotate_to_rad is not None else "dwell"
