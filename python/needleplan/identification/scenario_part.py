"""The needle and the tip noise of a scenario, identified from insertions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.artifacts import CallRepr
from needleplan.config import raw_of, toml_text
from needleplan.errors import DataError, Mistake
from needleplan.identification._curvature_trial import insertion_of
from needleplan.identification._entry_population import MeanPath, mean_path
from needleplan.identification._insertion_path import ShapeKind
from needleplan.identification._shape_choice import shaped_paths
from needleplan.identification._tip_noise import TipNoise, headings_at, tip_noise
from needleplan.recording import read_records
from needleplan.scenario import Scenario
from needleplan.signals import Array, Record, Role, records_of

__all__ = ["PathPiece", "ScenarioPart", "scenario_part"]

# Largest number of windows along x in which headings are estimated.
_MOST_WINDOWS = 6
# Number of points of each path that a window must exceed.
_POINTS_A_WINDOW = 4
# Number of pieces of constant curvature that stand for a smooth curvature, as in `plan --needle`.
_SMOOTH_PIECES = 8


@dataclass(frozen=True)
class PathPiece:
    """Mean curvature (1/mm) over the insertions, with 95 % interval, of the piece of the path from x = `low_mm` on."""

    curvature_per_mm: float
    low_per_mm: float
    high_per_mm: float
    low_mm: float


@dataclass(frozen=True)
class ScenarioPart(CallRepr):
    """A scenario with the identified needle and tip noise, and remarks on the identification.

    `noise` is the estimated tip noise; None for a single insertion, which does not determine noise. The scenario keeps
    its own tip noise if `noise` is None or not `ok`.
    """

    scenario: Scenario
    pieces: tuple[PathPiece, ...]
    noise: TipNoise | None
    remarks: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the lines of the tables [needle], [[needle.layer]] and [motion] of the scenario file."""
        tables = {"needle": raw_of(self.scenario.needle), "motion": raw_of(self.scenario.motion)}
        return toml_text(tables).strip().splitlines()


def scenario_part(
    records: object, scenario: Scenario, *, layers: int | None = 1, plane: str = "xy", skip_mm: float = 0.0
) -> ScenarioPart:
    """Identify curvature and tip noise from repeated insertions without rotation, and set them in a scenario.

    `records`, `layers`, `plane` and `skip_mm` are used as in `curvature.identify`, and the path is the same. x is along
    the insertion, with the entry at x = 0. `layers` is 1 to 10, or None for the choice by insertions left out. The last
    layer extends to the end of the workspace. The tip noise is computed from all trials without the role noise. Its
    step length and noise step are `[motion] step_mm` and `tip_noise_step_deg` of the scenario; by default, a step turns
    by one heading of the grid at the radius of the whole path. A layer may be straight if another layer bends and the
    scenario has `motion.step_mm`. If `layers` is None and the scenario does not permit the chosen shape, the result has
    one curvature.

    Raises DataError if records or `layers` cannot be used or a layer may be straight otherwise, and ScenarioError if
    the identified values violate a rule of the scenario.
    """
    used = [record for record in records_of(records, read_records) if record.role is not Role.NOISE]
    if not used:
        raise DataError(Mistake("role", "", "there is no trial to identify from"))
    insertions = [insertion_of(record, segments=1, plane=plane, skip_mm=skip_mm) for record in used]
    points = [insertion.points_mm for insertion in insertions]
    if layers is not None and not 1 <= layers <= 10:
        raise DataError(Mistake("layers", f"{layers}", "must be 1 to 10"))
    low, high = max(path[:, 0].min() for path in points), min(path[:, 0].max() for path in points)
    if low >= high:
        raise DataError(Mistake("x_mm", "", "the insertions have no common range of depth"))
    training = [
        insertion
        for insertion, record in zip(insertions, used, strict=True)
        if record.role in (Role.TRAIN, Role.REFERENCE)
    ] or insertions
    whole = mean_path(shaped_paths(training, 1).paths)
    choice = shaped_paths(training, layers)
    remarks = ["the layers of the scenario were replaced"] if scenario.needle.layers else []
    try:
        pieces, straight = _plannable(_pieces(mean_path(choice.paths)), scenario)
    except DataError:
        if layers is not None:
            raise
        pieces, straight = _plannable(_pieces(whole), scenario)
        straight = [f"{choice.remark}; the scenario cannot hold it: one curvature", *straight]
    else:
        straight += [choice.remark] * bool(choice.remark)
    changed = scenario.with_curvature(pieces)
    remarks += straight
    if scenario.tissues:
        remarks.append("the radii of the tissues of the scenario stay what they were")
    noise = _noise(used, points, (low, high), scenario, 1 / abs(float(whole.values[2])))
    if noise is None:
        remarks.append("one insertion says nothing about the tip noise, which stays that of the scenario")
    elif noise.ok:
        changed = changed.with_tip_noise(noise.probabilities)
        remarks.append(f"tip noise: {noise.says}")
    else:
        remarks.append(f"tip noise: {noise.says}; it stays that of the scenario")
    return ScenarioPart(changed, pieces, noise, tuple(remarks))


def _pieces(mean: MeanPath) -> tuple[PathPiece, ...]:
    """Return the pieces of a mean path, with the x at which each begins; a smooth curvature in equal pieces."""
    shape = mean.shape
    if shape.kind is ShapeKind.SMOOTH:
        places = np.linspace(0.0, shape.places_mm[-1], _SMOOTH_PIECES + 1)[:-1]
        middle = places + places[1] / 2
        weights = np.column_stack([np.interp(middle, shape.places_mm, row) for row in np.eye(shape.size)])
    else:
        places, weights = np.array([0.0, *shape.places_mm]), np.eye(shape.size)
    found = []
    for place, weight in zip(places, weights, strict=True):
        value = mean.combination(np.concatenate([[0.0, 0.0], weight]), "1/mm")
        low_mm = mean.tip(float(place))[0] if place else 0.0
        found.append(PathPiece(value.value, value.low, value.high, low_mm))
    return tuple(found)


def _plannable(pieces: Sequence[PathPiece], scenario: Scenario) -> tuple[tuple[PathPiece, ...], list[str]]:
    """Return the pieces for the scenario, and remarks on pieces that may be straight.

    A piece that may be straight keeps its curvature if it bends to the side of the other pieces, else its curvature is
    set to 0. Raises DataError if no piece surely bends, or a piece may be straight and the scenario has no `step_mm`.
    """
    bent = [each for each in pieces if not each.low_per_mm <= 0 <= each.high_per_mm]
    path_pieces: list[PathPiece] = []
    remarks: list[str] = []
    for piece in pieces:
        if piece in bent:
            path_pieces.append(piece)
            continue
        value = f"{piece.low_per_mm:.3g} to {piece.high_per_mm:.3g} from x = {piece.low_mm:.4g} mm on"
        if not bent or scenario.motion.step_mm is None:
            rule = "contains a straight path, and a plan needs a radius; take fewer layers, or longer insertions"
            rule += "; with motion.step_mm in the scenario, a layer may be straight" if bent else ""
            raise DataError(Mistake("curvature_per_mm", value, rule))
        same = piece.curvature_per_mm * bent[0].curvature_per_mm > 0
        path_pieces.append(piece if same else replace(piece, curvature_per_mm=0.0))
        used = f"radius {1 / abs(piece.curvature_per_mm):.4g} mm" if same else "a straight layer"
        remarks.append(f"the curvature {value} contains a straight path; planned with {used}")
    return tuple(path_pieces), remarks


def _noise(
    records: Sequence[Record],
    paths: Sequence[Array],
    ends_mm: tuple[float, float],
    scenario: Scenario,
    radius_mm: float,
) -> TipNoise | None:
    if len(paths) < 2:
        return None
    tracked = [
        Record(
            {"time_s": np.arange(len(path), dtype=float), "x_mm": path[:, 0], "y_mm": path[:, 1]},
            record.trial,
            frame=record.frame,
        )
        for record, path in zip(records, paths, strict=True)
    ]
    edges = np.linspace(*ends_mm, _windows(paths, ends_mm) + 1)
    middles, width = (edges[1:] + edges[:-1]) / 2, float(edges[1] - edges[0]) * (1 - 1e-9)
    headings, sd = headings_at(tracked, middles, width)
    motion = scenario.motion
    return tip_noise(
        headings, middles, headings=motion.headings, radius_mm=radius_mm, measurement_sd_rad=sd,
        step_mm=motion.step_length_mm(radius_mm), noise_step_rad=motion.noise_step_rad,
    )  # fmt: skip


def _windows(paths: Sequence[Array], ends_mm: tuple[float, float]) -> int:
    """Return the largest number of windows (3 to 6) such that each window has more than 4 points of every path.

    Returns 2 if there is no such number.
    """
    for windows in range(_MOST_WINDOWS, 2, -1):
        counts = [np.histogram(path[:, 0], windows, ends_mm)[0].min() for path in paths]
        if min(counts) > _POINTS_A_WINDOW:
            return windows
    return 2
