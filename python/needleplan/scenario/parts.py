"""The parts of a scenario: one frozen dataclass a TOML table, one rule a field.

Lengths are in mm. Every part checks itself when it is made and raises ScenarioError with all its mistakes; numbers
come out as float, sequences and arrays as tuples, names as members of their enumeration.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from itertools import pairwise
from typing import Any

from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario.choices import Method, Priority, Transition
from needleplan.scenario.polygon import Points, Simple
from needleplan.scenario.rules import (
    Choice,
    Integer,
    Maybe,
    Noise,
    Number,
    Odd,
    Pair,
    Refused,
    Rule,
    Text,
    sequence,
    shown,
    suggestion,
)

__all__ = [
    "Grid",
    "Layer",
    "Motion",
    "Needle",
    "Objective",
    "Obstacle",
    "Part",
    "Solver",
    "Target",
    "Tissue",
    "Workspace",
    "checked",
]

_LENGTH = Number("mm", above=0, at_most=1e6)
_COORDINATE = Number("mm", at_least=-1e6, at_most=1e6)
_COST = Number(at_least=0, at_most=1e9)


def _ruled(rule: Rule, default: object = MISSING, key: str = "") -> Any:
    """Declare a field that `rule` reads; `key` is its name in a file where that differs."""
    return field(default=default, metadata={"rule": rule, "key": key})


@dataclass(frozen=True)
class Part:
    """A table of a scenario; abstract."""

    def __post_init__(self) -> None:
        values, mistakes = checked(type(self), vars(self), type(self).__name__.lower())
        if mistakes:
            raise ScenarioError(mistakes)
        for name, value in values.items():
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Workspace(Part):
    """The rectangle [0, width] x [0, height] that the tip must not leave; its edges belong to it."""

    width_mm: float = _ruled(_LENGTH)
    height_mm: float = _ruled(_LENGTH)


@dataclass(frozen=True)
class Obstacle(Part):
    """A simple polygon that the tip must not touch; it may reach beyond the workspace."""

    polygon_mm: Points = _ruled(Simple(_COORDINATE))
    name: str = _ruled(Text(), "")


@dataclass(frozen=True)
class Target(Part):
    """The disc that the tip must reach; its rim belongs to it."""

    center_mm: tuple[float, float] = _ruled(Pair(_COORDINATE))
    radius_mm: float = _ruled(_LENGTH)


@dataclass(frozen=True)
class Layer(Part):
    """Tissue from the depth x = from_mm on, up to the next layer, with a radius of its own."""

    from_mm: float = _ruled(Number("mm", at_least=0, at_most=1e6))
    curvature_radius_mm: float = _ruled(_LENGTH)


@dataclass(frozen=True)
class _Layers:
    """Layers, each deeper than the one before."""

    def read(self, value: object) -> tuple[Layer, ...]:
        """Return the layers as a tuple. Raises Refused."""
        layers = sequence(value)
        if layers is None or not all(isinstance(layer, Layer) for layer in layers):
            raise Refused("must be layers; in a file each stands below its own [[needle.layer]]")
        found = [layer for layer in layers if isinstance(layer, Layer)]
        for before, after in pairwise(found):
            if after.from_mm <= before.from_mm:
                rule = "from_mm must increase from layer to layer"
                raise Refused(f"{rule}; {after.from_mm:g} comes after {before.from_mm:g}")
        return tuple(found)


@dataclass(frozen=True)
class Needle(Part):
    """The needle in its tissue: the radius of the arc that its bevel makes it follow, up to the first of the layers."""

    curvature_radius_mm: float = _ruled(_LENGTH)
    layers: tuple[Layer, ...] = _ruled(_Layers(), (), key="layer")


@dataclass(frozen=True)
class Tissue(Part):
    """A region with a radius of its own: a simple polygon, its boundary included; it may reach beyond the workspace."""

    polygon_mm: Points = _ruled(Simple(_COORDINATE))
    curvature_radius_mm: float = _ruled(_LENGTH)
    name: str = _ruled(Text(), "")


@dataclass(frozen=True)
class Motion(Part):
    """One step: an arc of one heading step, after which the heading is disturbed.

    `tip_noise` holds P(0), P(+-1), P(+-2) ... heading steps; `arc_samples` is the number of points of the arc that are
    tested for collision, exit and target (1 is the thesis).
    """

    headings: int = _ruled(Integer(4, 100_000), 60)
    tip_noise: tuple[float, ...] = _ruled(Noise(), (0.466, 0.24, 0.027))
    arc_samples: int = _ruled(Integer(1, 255), 4)


@dataclass(frozen=True)
class Grid(Part):
    """The grid of positions, and where the end of an arc lands on it.

    `success_refinement` k evaluates the success of the policy on a grid k times finer in x and in y. It is odd, so that
    each of the finer cells belongs to one grid point, whose policy it follows.
    """

    spacing_mm: tuple[float, float] = _ruled(Pair(_LENGTH), (1.0, 1.0))
    transition: Transition = _ruled(Choice(Transition), Transition.NEAREST)
    success_refinement: int = _ruled(Odd(1, 9), 1)

    def points(self, workspace: Workspace) -> tuple[int, int]:
        """Return the number of grid points along x and y: 0, dx, 2 dx ... round(width / dx) dx."""
        nx, ny = (
            round(size / spacing) + 1
            for size, spacing in zip((workspace.width_mm, workspace.height_mm), self.spacing_mm, strict=True)
        )
        return nx, ny


@dataclass(frozen=True)
class Objective(Part):
    """What is minimised: costs of insertion (per mm), of a rotation, and of the two failures.

    The default reaches the target first and then does the least damage. The thesis has rotation 40, collision 200,
    exit 100 and discount 0.95.
    """

    insertion_per_mm: float = _ruled(_COST, 1.0)
    rotation: float = _ruled(_COST, 4.0)
    collision: float = _ruled(_COST, 10_000.0)
    exit: float = _ruled(_COST, 10_000.0)
    discount: float = _ruled(Number(above=0, at_most=1), 1.0)


@dataclass(frozen=True)
class Solver(Part):
    """How the values are computed, and when they are good enough.

    `partitions` is how many there are along x and y for `Method.PPVI`; None means 12 x 8, or fewer on a smaller grid.
    `tolerance` is the lambda of the thesis: with a discount below one the solve ends at a Bellman residual below
    (1 - discount) * tolerance, which bounds the error of the values by `tolerance`. `threads` None means all cores.
    """

    method: Method = _ruled(Choice(Method), Method.SWEEP)
    partitions: tuple[int, int] | None = _ruled(Maybe(Pair(Integer(1, 65_536))), None)
    priority: Priority = _ruled(Choice(Priority), Priority.H2)
    tolerance: float = _ruled(Number(above=0, at_most=1e9), 0.01)
    max_sweeps: int | None = _ruled(Maybe(Integer(1, 1_000_000_000)), None)
    time_limit_s: float | None = _ruled(Maybe(Number("s", above=0, at_most=1e9)), None)
    threads: int | None = _ruled(Maybe(Integer(1, 1024)), None)


def checked(part: type[Part], raw: Mapping[str, object], key: str) -> tuple[dict[str, Any], list[Mistake]]:
    """Return the values of `part` that obey their rules, and the mistakes of the others.

    `raw` maps names of fields to values; unknown and missing names are mistakes; `key` is where the part stands.
    """
    values: dict[str, Any] = {}
    known = {each.name: each for each in fields(part)}
    mistakes = [
        Mistake(f"{key}.{name}", "", f"unknown key{suggestion(name, known)}") for name in raw if name not in known
    ]
    for name, each in known.items():
        if name in raw:
            try:
                values[name] = each.metadata["rule"].read(raw[name])
            except Refused as refused:
                place = f"{key}.{each.metadata['key'] or name}"
                mistakes.append(Mistake(place, shown(raw[name]), str(refused)))
        elif each.default is MISSING:
            mistakes.append(Mistake(f"{key}.{name}", "", "is missing"))
    return values, mistakes
