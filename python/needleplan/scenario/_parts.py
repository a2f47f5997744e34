"""The parts of a scenario: one frozen dataclass per TOML table, with a rule for each field. Lengths are in mm."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from itertools import pairwise

from needleplan.config import (
    REQUIRED,
    Choice,
    ConfigTable,
    Flag,
    Integer,
    Maybe,
    Number,
    Pair,
    TableList,
    Text,
    Violation,
    ruled,
    sequence,
)
from needleplan.errors import Mistake, ScenarioError
from needleplan.scenario import _shape
from needleplan.scenario._shape import COORDINATE, LENGTH, TOLERANCE_MM, Points

__all__ = [
    "Grid",
    "Layer",
    "Method",
    "Needle",
    "NoiseProbabilities",
    "Objective",
    "Priority",
    "Solver",
    "Target",
    "TipMotion",
    "Tissue",
    "Transition",
    "Workspace",
]


class _Radius:
    """Rule for the radius of a layer or tissue: a length, or infinity for a straight path."""

    def read(self, value: object) -> float:
        """Return the radius as a float. Raises Violation."""
        return math.inf if isinstance(value, float) and value == math.inf else LENGTH.read(value)


_RADIUS = _Radius()
# Largest number of grid points that is counted along an axis; no memory holds so many.
_MOST_POINTS = 1e15
_COST = Number(at_least=0, at_most=1e9)

# Largest number of probabilities in `motion.tip_noise`.
_NOISE_ENTRIES = 8
# Largest accepted |sum of all probabilities - 1|.
_NOISE_TOLERANCE = 1e-9


class Transition(StrEnum):
    """How the solver maps the end of an arc to grid points."""

    NEAREST = "nearest"
    """The end is rounded to the nearest grid point, as in the thesis."""

    INTERPOLATED = "interpolated"
    """The end is distributed over the four surrounding grid points with bilinear weights, so the mean is exact."""


class Method(StrEnum):
    """Algorithm that computes the optimal values."""

    SWEEP = "sweep"
    """Gauss-Seidel sweeps over the lattice, in the direction opposite to the needle's motion; the fastest method."""

    PPVI = "ppvi"
    """Prioritized-partitioned value iteration: only states whose inputs have changed are backed up. `Priority` chooses
    between parallel sweeps on the lattice and the scheme of section 6.3 of the thesis."""

    VALUE_ITERATION = "vi"
    """Plain value iteration: the simple reference for the other methods."""


class Priority(StrEnum):
    """Priority by which `Method.PPVI` chooses the states of the next backups.

    With `BOUND` it makes parallel sweeps on the lattice. `H1` and `H2` are the scheme of the thesis, on one thread: the
    partition of the highest priority is iterated alone until it converges.
    """

    H1 = "H1"
    """The Bellman residual, equation (6.7) of the thesis."""

    H2 = "H2"
    """The Bellman residual plus the value, equation (6.8) of the thesis."""

    BOUND = "bound"
    """An upper bound on the Bellman residual, accumulated from the changes of the values that a backup reads."""


def _points(size_mm: float, spacing_mm: float) -> int:
    """Return the smallest number of grid points whose last one is at `size_mm` or beyond, as the solver counts them."""
    cells = min(size_mm / spacing_mm, _MOST_POINTS)
    whole = round(cells)
    rounding = max(TOLERANCE_MM / spacing_mm, 1e-12 * whole)
    return (whole if abs(cells - whole) <= rounding else math.ceil(cells)) + 1


def _increasing(layers: tuple[Layer | None, ...]) -> Iterator[Mistake]:
    for number, (before, after) in enumerate(pairwise(layers), start=2):
        if before and after and after.from_mm <= before.from_mm:
            rule = f"must increase from layer to layer; {after.from_mm:g} comes after {before.from_mm:g}"
            yield Mistake(f"layer {number}.from_mm", f"{after.from_mm:g}", rule)


def _noise_below_half_a_turn(
    headings: int, tip_noise: tuple[float, ...], tip_noise_step_deg: float | None
) -> Iterator[Mistake]:
    reach = len(tip_noise) - 1
    if tip_noise_step_deg is not None:
        if reach * tip_noise_step_deg >= 180:
            rule = f"must be less than {180 / reach:g}, so that the tip noise stays below half a turn"
            yield Mistake("tip_noise_step_deg", f"{tip_noise_step_deg:g}", rule)
    elif 2 * reach >= headings:
        rule = f"must be more than {2 * reach}, so that the tip noise stays below half a turn"
        yield Mistake("headings", f"{headings}", rule)


def _refines_interpolated(transition: Transition, success_refinement: int | None) -> Iterator[Mistake]:
    if transition is Transition.NEAREST and success_refinement is not None and success_refinement > 1:
        rule = 'must be 1 beside transition = "nearest"'
        yield Mistake("success_refinement", f"{success_refinement}", rule)


def _insertion_costs(insertion_per_mm: float, straight_per_mm: float | None, discount: float) -> Iterator[Mistake]:
    for name, price in (("insertion_per_mm", insertion_per_mm), ("straight_per_mm", straight_per_mm)):
        if discount == 1 and price == 0:
            rule = "must be above 0 if the discount is 1: otherwise circling forever would cost nothing"
            yield Mistake(name, f"{price:g}", rule)


def _clearance_price(clearance_mm: float | None, clearance_per_mm: float | None) -> Iterator[Mistake]:
    if clearance_mm is None and clearance_per_mm is not None:
        yield Mistake(
            "clearance_mm", "", "is missing beside clearance_per_mm: the distance from obstacles with a price"
        )
    if clearance_mm is not None and clearance_per_mm is None:
        yield Mistake("clearance_per_mm", "", "is missing beside clearance_mm: the price per mm close to obstacles")


class NoiseProbabilities:
    """Rule for tip noise: probabilities P(0), P(+-1) ... of heading steps, P(+-k) for each sign.

    The sum P(0) + 2 (P(+-1) + ...) must be 1.
    """

    def read(self, value: object) -> tuple[float, ...]:
        """Return the probabilities as a tuple. Raises Violation."""
        entries = sequence(value)
        if entries is None or not 1 <= len(entries) <= _NOISE_ENTRIES:
            raise Violation(f"must be 1 to {_NOISE_ENTRIES} probabilities, [P(0), P(+-1), P(+-2), ...]", value)
        try:
            noise = tuple(Number(at_least=0, at_most=1).read(entry) for entry in entries)
        except Violation as broken:
            raise Violation(f"each probability {broken}", value) from None
        total = noise[0] + 2 * math.fsum(noise[1:])
        if abs(total - 1) > _NOISE_TOLERANCE:
            raise Violation(f"P(0) + 2 * (P(+-1) + P(+-2) + ...) must be 1, not {total:.10g}", value)
        return noise


@dataclass(frozen=True)
class Workspace(ConfigTable, key="workspace", error=ScenarioError):
    """The rectangle [0, width] x [0, height] in mm that the tip must not leave. The edges are inside the workspace."""

    width_mm: float = ruled(LENGTH, about="along x, the direction of insertion")
    height_mm: float = ruled(LENGTH, about="along y, lateral")


@dataclass(frozen=True)
class Target(ConfigTable, key="target", error=ScenarioError):
    """The disc that the tip must reach. The rim is part of the target."""

    center_mm: tuple[float, float] = ruled(Pair(COORDINATE), about="[x, y], in the workspace, outside of obstacles")
    radius_mm: float = ruled(LENGTH, about="the tip must come this close to the centre")


@dataclass(frozen=True)
class Layer(ConfigTable, key="needle.layer", error=ScenarioError):
    """A tissue layer from x = `from_mm` to the next layer, in which the needle's arc has the given radius."""

    from_mm: float = ruled(Number("mm", at_least=0, at_most=1e6), about="x at which the layer begins")
    curvature_radius_mm: float = ruled(_RADIUS, about="radius of the arc in this layer; inf: a straight path")


@dataclass(frozen=True)
class Needle(ConfigTable, key="needle", error=ScenarioError, between=(_increasing,)):
    """The needle: radius of its arc in front of the first tissue layer, layers with radii of their own, and diameter.

    The tip is the axis of the needle: half of `diameter_mm` is added to the margin of every obstacle.
    """

    curvature_radius_mm: float = ruled(LENGTH, about="radius of the arc that the needle follows without rotation")
    layers: tuple[Layer, ...] = ruled(TableList(Layer), (), key="layer")
    diameter_mm: float | None = ruled(
        Maybe(LENGTH), None, about="obstacles grow by half of it; absent: a needle without thickness"
    )


@dataclass(frozen=True)
class Tissue(
    _shape.Shaped,
    ConfigTable,
    key="tissue",
    error=ScenarioError,
    between=(_shape.one_shape("a tissue"), _shape.holes_inside),
):
    """A region in which the needle's arc has the given radius.

    The region is a simple polygon, which may have holes, a disc, or a capsule, boundary included: the same fields as
    those of an obstacle, without a margin. The region may reach beyond the workspace.
    """

    polygon_mm: Points | None = _shape.polygon("corners [x, y] of the region")
    curvature_radius_mm: float = ruled(_RADIUS, REQUIRED, about="radius of the arc in this region; inf: straight")
    name: str = ruled(Text(), "", about="for messages, figures and identified radii")
    holes_mm: tuple[Points, ...] | None = _shape.holes()
    center_mm: tuple[float, float] | None = _shape.center()
    ends_mm: Points | None = _shape.ends()
    radius_mm: float | None = _shape.radius()


@dataclass(frozen=True)
class TipMotion(ConfigTable, key="motion", error=ScenarioError, between=(_noise_below_half_a_turn,)):
    """One insertion step: the needle follows an arc of the length `step_mm`, then tip noise acts.

    Without `step_mm` the arc turns the heading by one heading step, 2 pi / `headings`, as in the thesis. `tip_noise`
    holds P(0), P(+-1), P(+-2) ...: the probabilities that the noise changes the heading by so many noise steps, P(+-k)
    for each sign. A noise step is `tip_noise_step_deg`, or one heading step without it. Collision, exit and target are
    tested on the whole arc. With `arc_samples` they are tested at so many equally spaced points of the arc only; the
    last point is the end. The thesis uses 1.

    With `straight_curvature_share` there is a third action, the straight step (Minhas et al. 2007: duty-cycled
    rotation). The needle turns all the time, or for a part of it, so that its curvature averages out except for this
    share of it, to the side of the bevel. The step ends with the bevel with which it began, and its noise is the same.
    """

    headings: int = ruled(Integer(4, 100_000), 60, about="headings of a full turn; without step_mm a step turns by one")
    tip_noise: tuple[float, ...] = ruled(
        NoiseProbabilities(),
        (0.466, 0.24, 0.027),
        about="P(0), P(+-1), P(+-2) ... noise steps; sum 1 with both signs",
    )
    arc_samples: int | None = ruled(
        Maybe(Integer(1, 255)), None, about="points of every arc tested; without it the whole arc is; 1: thesis"
    )
    step_mm: float | None = ruled(
        Maybe(Number("mm", above=0)), None, about="length of a step, for any curvature; absent: turns by one heading"
    )
    tip_noise_step_deg: float | None = ruled(
        Maybe(Number("deg", above=0, at_most=180)), None, about="noise step; absent: one heading"
    )
    straight_curvature_share: float | None = ruled(
        Maybe(Number(at_least=0, at_most=1)), None, about="curvature left in a straight step; absent: no straight steps"
    )

    def step_length_mm(self, radius_mm: float) -> float:
        """Return the length (mm) of a step with a radius: `step_mm`, else the arc that turns by one heading step."""
        return self.step_mm or 2 * math.pi * radius_mm / self.headings

    @property
    def noise_step_rad(self) -> float:
        """Heading difference (rad) between neighbouring values of the tip noise."""
        step_deg = self.tip_noise_step_deg
        return 2 * math.pi / self.headings if step_deg is None else math.radians(step_deg)


@dataclass(frozen=True)
class Grid(ConfigTable, key="grid", error=ScenarioError, between=(_refines_interpolated,)):
    """The grid of positions, and the rule that maps the end of an arc to grid points.

    With `refinement` k, the problem is solved on a grid that is k times finer in x and y; the table keeps every k-th
    point. The success probability is that of executions of the table, evaluated on a grid that is `success_refinement`
    times finer; without it, as fine as the steps need. With `heading_refinement` k, the table has k times the
    headings; without it, as many as the tip noise needs.
    """

    spacing_mm: tuple[float, float] = ruled(Pair(LENGTH), (1.0, 1.0), about="distance of grid points, [dx, dy]")
    transition: Transition = ruled(
        Choice(Transition), Transition.INTERPOLATED, about='"interpolated": unbiased; "nearest": the thesis'
    )
    success_refinement: int | None = ruled(
        Maybe(Integer(1, 9)), None, about="success is evaluated on a grid so many times finer; absent: by the step"
    )
    refinement: int | None = ruled(
        Maybe(Integer(1, 9)), None, about="solve on a grid so many times finer, and keep the points of this one"
    )
    heading_refinement: int | None = ruled(
        Maybe(Integer(1, 9)), None, about="plan with so many times the headings; absent: as many as the noise needs"
    )

    def points(self, workspace: Workspace) -> tuple[int, int]:
        """Return the number of grid points 0, dx, 2 dx ... along x and y that cover the workspace.

        If an extent is no multiple of the spacing, the last point lies beyond the border.
        """
        return _points(workspace.width_mm, self.spacing_mm[0]), _points(workspace.height_mm, self.spacing_mm[1])


@dataclass(frozen=True)
class Objective(ConfigTable, key="objective", error=ScenarioError, between=(_insertion_costs, _clearance_price)):
    """The costs whose expected sum is minimised: insertion per mm, rotation, collision, exit and clearance.

    With the default costs, success comes first and short paths with few rotations second. The thesis uses rotation 40,
    collision 200, exit 100 and discount 0.95. With discount 1, `insertion_per_mm` must be above 0.
    A step that begins within `clearance_mm` of an obstacle or its margin costs `clearance_per_mm` more per mm.
    A straight step (`TipMotion`) costs `straight_per_mm` for each mm instead of `insertion_per_mm`.
    """

    insertion_per_mm: float = ruled(_COST, 1.0, about="cost of 1 mm of insertion")
    rotation: float = ruled(_COST, 4.0, about="cost of a rotation by half a turn")
    collision: float = ruled(_COST, 10_000.0, about="cost of touching an obstacle, which ends the insertion")
    exit: float = ruled(_COST, 10_000.0, about="cost of leaving the workspace, which ends the insertion")
    discount: float = ruled(Number(above=0, at_most=1), 1.0, about="weight of the next step's cost; the thesis: 0.95")
    clearance_mm: float | None = ruled(
        Maybe(LENGTH), None, about="steps that begin so close to an obstacle cost clearance_per_mm more per mm"
    )
    clearance_per_mm: float | None = ruled(
        Maybe(_COST), None, about="additional cost of 1 mm of insertion within clearance_mm of an obstacle"
    )
    straight_per_mm: float | None = ruled(
        Maybe(_COST), None, about="cost of 1 mm of a straight step; absent: insertion_per_mm"
    )


@dataclass(frozen=True)
class Solver(ConfigTable, key="solver", error=ScenarioError):
    """The algorithm that computes the values, and its stopping rules.

    - `partitions`: number of partitions along x and y for `Method.PPVI`; None means 12 x 8, or fewer on a smaller grid
    - `tolerance`: the solve ends when no value is wrong by more than this; the lambda of the thesis. With a discount
      below 1, this is a Bellman residual below (1 - discount) * `tolerance`.
    - `max_sweeps`, `time_limit_s`: the solve also ends after so many sweeps or seconds; None means 100,000 sweeps and
      no time limit
    - `threads`: number of threads; None means all cores
    - `success_bound`: whether to compute a bound on the error of the success, which takes about as long as the success
    """

    method: Method = ruled(
        Choice(Method), Method.SWEEP, about='"sweep": fastest; "ppvi": fewest backups; "vi": plain value iteration'
    )
    partitions: tuple[int, int] | None = ruled(
        Maybe(Pair(Integer(1, 65_536))), None, about='partitions along x and y, for "ppvi"'
    )
    priority: Priority = ruled(
        Choice(Priority), Priority.BOUND, about='"bound"; "H1", "H2": as in the thesis; for "ppvi"'
    )
    tolerance: float = ruled(Number(above=0, at_most=1e9), 0.01, about="largest admissible error of the values")
    max_sweeps: int | None = ruled(Maybe(Integer(1, 1_000_000_000)), None, about="end the solve after so many sweeps")
    time_limit_s: float | None = ruled(Maybe(Number("s", above=0, at_most=1e9)), None, about="end the solve then")
    threads: int | None = ruled(Maybe(Integer(1, 1024)), None, about="number of threads; all cores without it")
    success_bound: bool = ruled(Flag(), False, about="compute a bound on the error of the success")
