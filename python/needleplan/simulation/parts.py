"""The tables of an experiment: one frozen dataclass per table, one rule per field.

Lengths in mm, forces in N, times in s, angles in rad.
"""

from __future__ import annotations

from dataclasses import dataclass

from needleplan.config import ConfigTable, Integer, Maybe, Number, ruled
from needleplan.errors import ExperimentError

__all__ = ["Entry", "Layer", "Move", "Robot", "Shaft", "Tissue"]

_BEND = Number("1/mm", at_least=-1, at_most=1)
_FORCE = Number("N", at_least=0, at_most=100)
_DEPTH = Number("mm", at_least=-100, at_most=1000)


@dataclass(frozen=True)
class Entry(ConfigTable, key="entry", error=ExperimentError):
    """Pose of the needle at the start: the line of entry meets the surface of the tissue at `x_mm`, `y_mm`.

    `depth_mm` is the depth of the tip beyond the surface, `roll_rad` the roll of the base: at 0 the needle bends to the
    left, at pi to the right.
    """

    x_mm: float = ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    y_mm: float = ruled(Number("mm", at_least=-1000, at_most=1000), 0.0)
    heading_rad: float = ruled(Number("rad", at_least=-1.6, at_most=1.6), 0.0)
    depth_mm: float = ruled(Number("mm", at_least=-100, at_most=0), 0.0)
    roll_rad: float = ruled(Number("rad", at_least=-7, at_most=7), 0.0)


@dataclass(frozen=True)
class Tissue(ConfigTable, key="tissue", error=ExperimentError):
    """The tissue outside of layers; without `curvature_per_mm` the needle bends as the needle of the scenario."""

    curvature_per_mm: float | None = ruled(Maybe(_BEND), None)
    cutting_n: float = ruled(_FORCE, 0.0)
    puncture_n: float = ruled(_FORCE, 0.0)
    stretch_mm: float = ruled(Number("mm", above=0, at_most=50), 2.0)


@dataclass(frozen=True)
class Layer(ConfigTable, key="layer", error=ExperimentError):
    """Tissue deeper than `from_mm` along the entry, with its own curvature and cutting force, and a membrane.

    The force on the membrane rises linearly to `puncture_n` over `stretch_mm` and drops to 0 at the puncture. Without
    `curvature_per_mm` the needle bends as in the tissue.
    """

    from_mm: float = ruled(Number("mm", at_least=0, at_most=1000))
    curvature_per_mm: float | None = ruled(Maybe(_BEND), None)
    cutting_n: float = ruled(_FORCE, 0.0)
    puncture_n: float = ruled(_FORCE, 0.0)
    stretch_mm: float = ruled(Number("mm", above=0, at_most=50), 2.0)


@dataclass(frozen=True)
class Shaft(ConfigTable, key="shaft", error=ExperimentError):
    """Torsional stiffness GJ and length of the needle's shaft. The default is an 18 gauge cannula."""

    torsional_stiffness_n_mm2: float = ruled(Number("N mm^2", above=0, at_most=1e9), 1.5e4)
    length_mm: float = ruled(Number("mm", at_least=10, at_most=1000), 200.0)


@dataclass(frozen=True)
class Robot(ConfigTable, key="robot", error=ExperimentError):
    """Servo and limits of both axes, insertion and roll."""

    servo_hz: int = ruled(Integer(200, 20_000), 1000)
    bandwidth_hz: float = ruled(Number("Hz", at_least=1, at_most=60), 20.0)
    top_velocity_mm_s: float = ruled(Number("mm/s", above=0, at_most=1000), 50.0)
    acceleration_mm_s2: float = ruled(Number("mm/s^2", above=0, at_most=1e5), 100.0)
    shallowest_mm: float = ruled(_DEPTH, -100.0)
    deepest_mm: float = ruled(_DEPTH, 180.0)
    top_velocity_rad_s: float = ruled(Number("rad/s", above=0, at_most=1000), 12.0)
    acceleration_rad_s2: float = ruled(Number("rad/s^2", above=0, at_most=1e5), 60.0)


@dataclass(frozen=True)
class Move(ConfigTable, key="move", error=ExperimentError):
    """One move of a program: `insert_to_mm`, `rotate_to_rad` or `dwell_s`; the first two at a speed."""

    insert_to_mm: float | None = ruled(Maybe(_DEPTH), None)
    velocity_mm_s: float | None = ruled(Maybe(Number("mm/s", above=0, at_most=1000)), None)
    rotate_to_rad: float | None = ruled(Maybe(Number("rad", at_least=-1000, at_most=1000)), None)
    velocity_rad_s: float | None = ruled(Maybe(Number("rad/s", above=0, at_most=1000)), None)
    dwell_s: float | None = ruled(Maybe(Number("s", above=0, at_most=3600)), None)

    @property
    def label(self) -> str:
        """Name of the phase in the recording."""
        if self.insert_to_mm is not None:
            return f"to {self.insert_to_mm:g} mm"
        return f"roll to {self.rotate_to_rad:g} rad" if self.rotate_to_rad is not None else "dwell"
