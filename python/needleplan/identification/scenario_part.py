"""The needle and the tip noise of a scenario, identified from insertions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needleplan.config import raw_of, toml_text
from needleplan.errors import DataError, Mistake
from needleplan.identification._circle import fit_circle
from needleplan.identification._curvature_trial import insertion_of
from needleplan.identification._path_curvature import Curvature, agreement, path_curvature
from needleplan.identification._tip_noise import TipNoise, headings_at, tip_noise
from needleplan.models import arc_step
from needleplan.scenario import Scenario
from needleplan.signals import Array, Record, Role

__all__ = ["PathPiece", "ScenarioPart", "scenario_part"]

# Largest number of windows along x in which headings are estimated.
_MOST_WINDOWS = 6
# Number of points of each path that a window must exceed.
_POINTS_A_WINDOW = 4


@dataclass(frozen=True)
class PathPiece:
    """Mean curvature (1/mm) over all insertions, with 95 % interval, of the piece of the path from x = `low_mm` on."""

    curvature_per_mm: float
    low_per_mm: float
    high_per_mm: float
    low_mm: float


@dataclass(frozen=True)
class ScenarioPart:
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
    records: Sequence[Record], scenario: Scenario, *, layers: int = 1, plane: str = "xy", skip_mm: float = 0.0
) -> ScenarioPart:
    """Identify curvature and tip noise from repeated insertions without rotation, and set them in a scenario.

    `records`, `plane` and `skip_mm` are used as in `curvature.identify`; x is along the insertion, with the entry at
    x = 0. The range of x that all insertions cover is cut into `layers` equal parts, 1 to 10, with one radius each. The
    last layer extends to the end of the workspace. The tip noise is computed for the step length and the noise step of
    the scenario, `[motion] step_mm` and `tip_noise_step_deg`; without them, for one heading of the grid per step at the
    radius of the whole path. A layer may be straight if another layer bends and the scenario has `motion.step_mm`.
    Raises DataError if records or `layers` cannot be used or a layer may be straight otherwise, and ScenarioError if
    the identified values violate a rule of the scenario.
    """
    used = [record for record in records if record.role is not Role.NOISE]
    if not used:
        raise DataError(Mistake("role", "", "there is no trial to identify from"))
    insertions = [insertion_of(record, segments=1, plane=plane, skip_mm=skip_mm) for record in used]
    paths = [each.points_mm for each in insertions]
    if not 1 <= layers <= 10:
        raise DataError(Mistake("layers", f"{layers}", "must be 1 to 10"))
    low, high = max(path[:, 0].min() for path in paths), min(path[:, 0].max() for path in paths)
    if low >= high:
        raise DataError(Mistake("x_mm", "", "the insertions have no common range of depth"))
    whole = _mean([each.whole for each in insertions], 0.0)
    edges = np.linspace(low, high, layers + 1)[1:-1]
    pieces, straight = _plannable(_pieces(paths, edges) if layers > 1 else (whole,), scenario)
    changed = scenario.with_curvature(pieces)
    remarks = ["the layers of the scenario were replaced"] if scenario.needle.layers else []
    remarks += straight
    if scenario.tissues:
        remarks.append("the radii of the tissues of the scenario stay what they were")
    noise = _noise(used, paths, (low, high), scenario, 1 / abs(whole.curvature_per_mm))
    if noise is None:
        remarks.append("one insertion says nothing about the tip noise, which stays that of the scenario")
    elif noise.ok:
        changed = changed.with_tip_noise(noise.probabilities)
        remarks.append(f"tip noise: {noise.says}")
    else:
        remarks.append(f"tip noise: {noise.says}; it stays that of the scenario")
    return ScenarioPart(changed, pieces, noise, tuple(remarks))


def _pieces(paths: Sequence[Array], edges_mm: Array) -> tuple[PathPiece, ...]:
    """Return one piece for each layer, with the mean curvature over the paths. `edges_mm` are the inner layer edges."""
    found = [path_curvature(path, _along(path, edges_mm))[0] for path in paths]
    starts = [0.0, *edges_mm.tolist()]
    return tuple(_mean(each, start) for each, start in zip(zip(*found, strict=True), starts, strict=True))


def _mean(trials: Sequence[Curvature], low_mm: float) -> PathPiece:
    """Return the mean curvature of one piece over the trials; `low_mm` is the x at which the piece begins."""
    if len(trials) == 1:
        only = trials[0]
        return PathPiece(only.curvature_per_mm, only.low_per_mm, only.high_per_mm, low_mm)
    together = agreement(trials)
    return PathPiece(together.mean_per_mm, together.low_per_mm, together.high_per_mm, low_mm)


def _plannable(pieces: Sequence[PathPiece], scenario: Scenario) -> tuple[tuple[PathPiece, ...], list[str]]:
    """Return the pieces for the scenario, and remarks on pieces that may be straight.

    A piece that may be straight keeps its curvature if it bends to the side of the other pieces, else its curvature is
    set to 0. Raises DataError if no piece surely bends, or a piece may be straight and the scenario has no `step_mm`.
    """
    bent = [each for each in pieces if not each.low_per_mm <= 0 <= each.high_per_mm]
    found: list[PathPiece] = []
    remarks: list[str] = []
    for piece in pieces:
        if piece in bent:
            found.append(piece)
            continue
        value = f"{piece.low_per_mm:.3g} to {piece.high_per_mm:.3g} from x = {piece.low_mm:.4g} mm on"
        if not bent or scenario.motion.step_mm is None:
            rule = "contains a straight path, and a plan needs a radius; take fewer layers, or longer insertions"
            rule += "; with motion.step_mm in the scenario, a layer may be straight" if bent else ""
            raise DataError(Mistake("curvature_per_mm", value, rule))
        same = piece.curvature_per_mm * bent[0].curvature_per_mm > 0
        found.append(piece if same else replace(piece, curvature_per_mm=0.0))
        used = f"radius {1 / abs(piece.curvature_per_mm):.4g} mm" if same else "a straight layer"
        remarks.append(f"the curvature {value} contains a straight path; planned with {used}")
    return tuple(found), remarks


def _along(path: Array, x_mm: Array) -> list[float]:
    """Return the distances (mm) along the fitted circle from the smallest x of a path to each of `x_mm`."""
    circle = fit_circle(path)
    reach = np.hypot(*np.ptp(path, axis=0))
    distance = np.linspace(-2 * reach, 2 * reach, 4001)
    x, _, heading = arc_step(*circle.point_mm, circle.heading_rad, circle.curvature_per_mm, distance)
    forward = np.abs(heading) < np.pi / 2
    at = np.interp([path[:, 0].min(), *x_mm], x[forward], distance[forward])
    return [float(each) for each in at[1:] - at[0]]


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
        Record({"time_s": np.arange(len(path), dtype=float), "x_mm": path[:, 0], "y_mm": path[:, 1]}, record.trial)
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
    """Return the largest number of windows, 3 to 6, of which each has more than 4 points of every path.

    Returns 2 if there is no such number.
    """
    for windows in range(_MOST_WINDOWS, 2, -1):
        counts = [np.histogram(path[:, 0], windows, ends_mm)[0].min() for path in paths]
        if min(counts) > _POINTS_A_WINDOW:
            return windows
    return 2
